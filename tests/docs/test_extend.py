"""The tutorials show files of the examples, and their task is registered and evaluated."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from skatemount.config import compose, set_user_config_dir
from skatemount.config.registries import registries
from skatemount.evaluation import report
from skatemount.evaluation.evaluator import Evaluator
from skatemount.training.setup import make_networks

ROOT = Path(__file__).resolve().parents[2]
LAB = ROOT / "examples" / "own_lab"
SMALL = [
    "network.actor=[8]",
    "network.critic=[8]",
    "episode_length=0.4",
    "physics.threads=1",
    "physics.num_worlds=4",
]


@pytest.fixture
def conf(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The example's settings; its plugins can be imported."""
    monkeypatch.syspath_prepend(str(LAB))
    known = registries()
    saved = [registry.snapshot() for registry in known]
    yield LAB / "conf"
    set_user_config_dir(None)
    for registry, before in zip(known, saved):
        registry.restore(before)
    for module in [name for name in sys.modules if name.split(".")[0] == "own_lab"]:
        del sys.modules[module]


SHOWN = {"own_reward": 2, "own_board": 1, "own_stage": 2, "own_robot": 2, "own_task": 2, "take_to_robot": 2}
"""Number of files that a tutorial shows."""


@pytest.mark.parametrize("page", [*(f"tutorials/{name}" for name in SHOWN), "extend_learning"])
def test_the_pages_show_files_of_the_examples(page: str) -> None:
    path = ROOT / "docs" / f"{page}.md"
    shown = re.findall(
        r"^```\{literalinclude\} (\S+)\n(.*?)^```$", path.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
    )
    assert len(shown) == SHOWN.get(path.stem, 6)
    for file, options in shown:
        text = (path.parent / file).read_text(encoding="utf-8")
        for start in re.findall(r"^:(?:start-at|end-before): (.+)$", options, re.MULTILINE):
            assert start in text, f"{file} has no {start!r}"


def test_the_page_shows_the_labs_folder() -> None:
    text = (ROOT / "docs" / "extend.md").read_text(encoding="utf-8")
    (tree,) = re.findall(r"^```text\nconf/\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    files = [path.relative_to(LAB / "conf").as_posix() for path in (LAB / "conf").rglob("*.yaml")]
    assert re.findall(r"[\w-]+/[\w.-]+", tree) == sorted(files)


def test_the_task_of_the_page_is_evaluated(conf: Path) -> None:
    config = compose("lab_carry", SMALL, config_dir=conf)
    assert config.success == "lab_carry" and "own_lab.tasks" in config.plugins
    assert config.reward["flat_orientation"].weight == 1.0 and config.total_frames == 1_000_000
    evaluator = Evaluator(config, 4, seed=1)
    torch.manual_seed(0)
    try:
        networks = make_networks(config, evaluator.env.mdp)
        result = evaluator.run(networks, 4)
    finally:
        evaluator.close()
    document = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert 0 < document["final_tilt"] < 90 and document["largest_tilt"]["median"] > 0
    assert 0 <= document["feet"] <= 4 and document["energy"] > 0
    failed = 4 - round(4 * document["success"]["rate"])
    assert document["failures"] == ({"spilled": failed} if failed else {})
    assert [
        name for name in ("tilt at the end", "largest tilt", "feet on the deck") if name not in report.table(result)
    ] == []
