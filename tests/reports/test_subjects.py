"""Read runs and policies for pages."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from skatemount.reports.subjects import Stage, Subject, find_subject, flat, joined, last_mean
from skatemount.runs.metrics import read_metrics
from skatemount.utils.errors import ConfigError

OLD_RUN = Path(__file__).parents[1] / "golden" / "data" / "old_run"


def test_a_run_by_all_its_names(root: Path, first: Path) -> None:
    (checkpoint,) = (first / "checkpoints").glob("step_*")
    names = [str(first), f"skatemount/{first.name}", str(checkpoint), f"{first}/latest"]
    for name in names:
        subject = find_subject(name, root)
        assert subject.name == first.name and subject.spec == str(checkpoint) and subject.folder == first
    assert find_subject("latest", root).folder.parent == first.parent
    subject = find_subject(str(first), root)
    (stage,) = subject.stages
    table = read_metrics(first / "metrics.jsonl")
    np.testing.assert_array_equal(stage.table["Loss/kl"], table["Loss/kl"])
    assert stage.name == "balance" and subject.frames == table["frames"][-1] and 0 < subject.seconds < 600
    assert subject.command.startswith("python -m skatemount.train stage=balance physics.num_worlds=8 ")
    assert subject.commit is not None and len(subject.commit) == 40
    assert "torch" in subject.environment and "cpu_usable" in subject.environment
    assert subject.final("Loss/kl") == pytest.approx(table["Loss/kl"][-1])
    assert subject.final("nothing") is None


def test_a_run_without_a_checkpoint(root: Path, begun: Path) -> None:
    subject = find_subject(str(begun), root)
    assert subject.spec is None and subject.card is None and subject.frames == 0 and not subject.stages[0].table
    assert subject.overrides == ["stage=balance"]


def test_a_shipped_policy_and_a_run_of_an_older_version(root: Path) -> None:
    shipped = find_subject("pretrained:balance", root)
    assert shipped.name == "pretrained:balance" and shipped.folder is None and shipped.command is None
    assert shipped.frames == shipped.card.frames and shipped.seconds > 60
    old = find_subject(str(OLD_RUN), root)
    assert old.frames == 160 and "algorithm.clip_epsilon" in flat(old.config)


def test_what_does_not_exist_is_named(root: Path) -> None:
    with pytest.raises(ConfigError, match="^against=nowhere: not found"):
        find_subject("nowhere", root, "against")


def test_settings_by_dotted_key() -> None:
    assert flat({"a": {"b": 1, "c": {}}, "d": [1]}) == {"a.b": 1, "a.c": {}, "d": [1]}


def test_the_end_of_a_series() -> None:
    assert last_mean(np.array([1.0, np.nan, 3.0])) == 3.0
    assert last_mean(np.concatenate((np.zeros(90), np.ones(10), [np.nan]))) == 1.0


def test_the_parts_of_a_chain_as_one_training() -> None:
    parts = [Stage("a", {}, {"frames": np.array([1.0, 2.0]), "m": np.array([5.0, 6.0])}, Path()),
             Stage("b", {}, {}, Path()),
             Stage("c", {}, {"frames": np.array([3.0])}, Path())]  # fmt: skip
    whole, starts = joined(Subject("chain", None, {}, stages=parts))
    assert whole.table["frames"].tolist() == [1.0, 2.0, 5.0] and starts == [(0.0, "a"), (2.0, "c")]
    assert whole.table["m"][:2].tolist() == [5.0, 6.0] and np.isnan(whole.table["m"][2])
    assert joined(Subject("none", None, {}, stages=parts[1:2])) is None
