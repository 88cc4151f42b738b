"""The page of a sweep, and of several runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from parsed_page import Page

from skatemount.config import compose_program
from skatemount.evaluation.intervals import wilson_interval
from skatemount.report import report
from skatemount.reports.subjects import Stage
from skatemount.reports.sweep_page import Member, over_seeds, read_group, success_over_seeds
from skatemount.runs.metrics import read_metrics
from skatemount.runs.sweep import Score
from skatemount.utils.errors import ConfigError

SECTIONS = ["runs", "seeds", "suites", "curves", "rewards", "settings", "repeat"]


def page(tmp_path: Path, *settings: str) -> Page:
    given = [*settings, f"output={tmp_path / 'r.html'}"]
    report(compose_program("report", given), given)
    found = Page((tmp_path / "r.html").read_text(encoding="utf-8"))
    found.check_whole()
    return found


def test_a_sweep(sweep: Path, first: Path, tmp_path: Path) -> None:
    made = page(tmp_path, f"sweep={sweep}")
    assert list(made.sections) == SECTIONS
    assert made.row("learning_rate=1e-3,seed=1")[1:3] == ["1e-3", "1"]
    low, high = wilson_interval(3, 4)
    assert made.row("learning_rate=1e-3,seed=0")[3].split("\n")[0].startswith("75.0 %")
    assert f"{100 * low:.1f} to {100 * high:.1f} %" in made.row("learning_rate=1e-3,seed=0")[3]
    assert "algorithm.learning_rate=9 must be smaller" in made.sections["runs"]
    assert made.row("learning_rate=1e-3")[1] == "2" and made.row("learning_rate=9")[1] == "0 of 1"
    (mean,) = (r["values"] for r in made.charts["success at the end"]["rows"] if r["label"] == "learning_rate=1e-3")
    assert mean[0][0] == pytest.approx(0.875)
    lines = {line["label"]: line for line in made.charts["KL divergence of an update"]["lines"]}
    assert list(lines) == ["learning_rate=1e-3", "learning_rate=3e-4"]
    table = read_metrics(first / "metrics.jsonl")
    np.testing.assert_allclose(lines["learning_rate=1e-3"]["y"], table["Loss/kl"], rtol=1e-5)
    assert "skatemount.train -m stage=balance algorithm.learning_rate=1e-3,3e-4,9 seed=0,1" in made.sections["repeat"]


def test_several_runs(first: Path, second: Path, tmp_path: Path) -> None:
    made = page(tmp_path, f"runs=[{first},'{second}',pretrained:balance]")
    assert list(made.sections) == SECTIONS and "img" not in made.elements
    assert made.row("algorithm.learning_rate")[1:3] == ["0.001", "0.0003"]
    assert "balance-fixed" in made.sections["suites"]  # of the card


def test_mean_and_range_over_runs() -> None:
    def stage(frames: list[float], values: list[float]) -> Stage:
        return Stage("s", {}, {"frames": np.array(frames), "m": np.array(values)}, Path())

    line = over_seeds([stage([0, 10, 20], [0, 1, 2]), stage([5, 15, 25], [2.5, 3.5, 4.5])], "m", "a", 3)
    assert line is not None and line.color == 3
    np.testing.assert_allclose(line.x, [5, 10, 15, 20])
    np.testing.assert_allclose(line.y, [1.5, 2.0, 2.5, 3.0])
    np.testing.assert_allclose(line.high - line.low, 2.0)  # type: ignore[operator]
    assert over_seeds([stage([0], [np.nan])], "m", "a", 0) is None
    assert over_seeds([stage([0, 1], [0, 1]), stage([5, 6], [0, 1])], "m", "a", 0) is None


def test_the_interval_is_never_narrower_than_that_of_the_episodes() -> None:
    def member(successes: int) -> Member:
        return Member("m", {}, None, Score.of(successes, 100), "finished")

    assert success_over_seeds([member(99), member(99)]) == pytest.approx((0.99, *wilson_interval(198, 200)))
    mean, low, high = success_over_seeds([member(50), member(90)])  # type: ignore[misc]
    assert mean == pytest.approx(0.7) and low == 0.0 and high == 1.0
    assert success_over_seeds([Member("m", {}, None, None, "failed")]) is None


def test_what_is_no_sweep_is_named(root: Path, first: Path, sweep: Path, tmp_path: Path) -> None:
    for given in (first, "nowhere"):
        config = compose_program("report", [f"sweep={given}", f"logger.root={root}"])
        with pytest.raises(ConfigError, match=f"^sweep={given}: must be the folder of a multirun .*{sweep.name}"):
            read_group(config)
