"""The commands that a training proposes at its end."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from skatemount.config import compose, set_user_config_dir, to_dict
from skatemount.runs.checkpoint import POLICY_FILE, PolicyCard, save_policy
from skatemount.runs.folder import RunFolder
from skatemount.training.commands import next_commands, what_is_left
from skatemount.utils.ranks import ALONE


@pytest.fixture
def own(tmp_path: Path) -> Iterator[Path]:
    """A folder with a suite of one's own for the stage balance, in another task."""
    folder = tmp_path / "my conf"
    (folder / "suite").mkdir(parents=True)
    (folder / "suite" / "a-balance.yaml").write_text(
        "name: a-balance\nversion: 1\ndescription: walk\nstage: balance\noverrides: [success=gait]\n", encoding="utf-8"
    )
    (folder / "suite" / "b-balance.yaml").write_text("stage: [balance\n", encoding="utf-8")
    yield folder
    set_user_config_dir(None)


def made(root: Path, *overrides: str) -> RunFolder:
    """Return a run of the stage balance with one checkpoint."""
    config = to_dict(compose("balance", overrides))
    # Classes of one's own are named after composing, which would import them.
    config["network"]["kind"], config["callbacks"] = "my_nets:Mine", ["my_hooks.mine:Each"]
    run = RunFolder.create(root, "exp", "run", config, [])
    save_policy(run.checkpoint(8) / POLICY_FILE, {"a": torch.nn.Linear(1, 1)}, PolicyCard(stage="balance", config={}))
    run.mark_checkpoint(run.checkpoint(8), None)
    return run


def evaluated(run: RunFolder) -> list[str]:
    """Return the settings of the proposed evaluation."""
    _, evaluate, _ = next_commands(run).splitlines()
    return shlex.split(evaluate)[3:]


def test_a_suite_of_another_task_is_not_proposed(own: Path, tmp_path: Path) -> None:
    mount, gait = made(tmp_path), made(tmp_path, "task=gait")
    assert "suite=balance-fixed" in evaluated(mount)
    assert not any(each.startswith("suite=") for each in evaluated(gait))
    set_user_config_dir(own)
    assert "suite=balance-fixed" in evaluated(mount)
    assert evaluated(gait)[:2] == ["--config-dir", str(own)] and evaluated(gait)[-1] == "suite=a-balance"


def test_commands_name_the_modules_that_they_import(tmp_path: Path) -> None:
    run = made(tmp_path)
    for line in next_commands(run).splitlines()[1:]:
        assert "plugins=[my_nets]" in shlex.split(line)
    assert what_is_left(SimpleNamespace(run=run, saved_frames=8, frames=8, stopping=False, ranks=ALONE)) == (
        f"8 steps are saved in {run.latest}; go on with: python -m skatemount.train resume={run.path} "
        "'plugins=[my_nets,my_hooks.mine]'"
    )
