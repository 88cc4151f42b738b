"""The task of the page "Use your own", registered and evaluated as it stands there."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from skatemount.config import compose
from skatemount.envs.tasks import TASKS
from skatemount.evaluation import report
from skatemount.evaluation.evaluator import Evaluator
from skatemount.training.setup import make_networks

ROOT = Path(__file__).resolve().parents[2]
SMALL = [
    "network.actor=[8]",
    "network.critic=[8]",
    "episode_length=0.4",
    "physics.threads=1",
    "physics.num_worlds=4",
]


def blocks(language: str) -> list[str]:
    """Return the code blocks of the section about tasks."""
    text = (ROOT / "docs" / "extend.md").read_text(encoding="utf-8")
    section = text.split("\n## Tasks\n")[1].split("\n## ")[0]
    return re.findall(rf"^```{language}\n(.*?)^```", section, re.DOTALL | re.MULTILINE)


@pytest.fixture
def conf(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The page's files: a plugin that can be imported, and a folder of settings."""
    (code,), (task, stage) = blocks("python"), blocks("yaml")
    for name, text in (("tasks.py", code), ("__init__.py", "")):
        (tmp_path / "my_package").mkdir(exist_ok=True)
        (tmp_path / "my_package" / name).write_text(text, encoding="utf-8")
    for group, text in (("task", task), ("stage", stage)):
        (tmp_path / "my_conf" / group).mkdir(parents=True)
        (tmp_path / "my_conf" / group / "crouch.yaml").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    saved = TASKS.snapshot()
    yield tmp_path / "my_conf"
    TASKS.restore(saved)
    for module in [name for name in sys.modules if name.split(".")[0] == "my_package"]:
        del sys.modules[module]


def test_the_task_of_the_page_is_evaluated(conf: Path) -> None:
    config = compose("crouch", SMALL, config_dir=conf)
    assert (config.success, config.plugins) == ("crouch", ["my_package.tasks"])
    assert config.reward["base_height"].weight == 0.0 and config.total_frames == 2_000_000
    evaluator = Evaluator(config, 4, seed=1)
    torch.manual_seed(0)
    try:
        networks = make_networks(config, evaluator.env.mdp)
        result = evaluator.run(networks, 4)
    finally:
        evaluator.close()
    document = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert 0.2 < document["lowest"]["median"] <= document["final_height"] < 0.5
    assert 0 <= document["feet"] <= 4 and document["energy"] > 0
    assert document["success"]["rate"] == 0.0 and document["failures"] == {"too_high": 4}
    assert "4: not crouched at the time limit 4" in report.table(result)
