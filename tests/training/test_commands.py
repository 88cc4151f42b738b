"""The commands that a training proposes at its end."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
import torch.distributed as dist

from skatemount.config import compose, set_user_config_dir, to_dict
from skatemount.runs.checkpoint import POLICY_FILE, PolicyCard, save_policy
from skatemount.runs.folder import RunFolder
from skatemount.training.commands import next_commands, what_is_left
from skatemount.training.connection import Connection
from skatemount.training.distributed import JoinedRanks
from skatemount.utils.ranks import ALONE, Ranks


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
    assert left(run, ALONE) == (
        f"8 steps are saved in {run.latest}; go on with: python -m skatemount.train resume={run.path} "
        "'plugins=[my_nets,my_hooks.mine]'"
    )


def left(run: RunFolder, ranks: Ranks, *overrides: str) -> str:
    """Return what a training says that has ended early."""
    values = {"saved_frames": 8, "frames": 8, "stopping": False}
    return what_is_left(SimpleNamespace(run=run, ranks=ranks, overrides=list(overrides), **values))


def test_the_way_on_keeps_what_a_resumed_run_has_changed(tmp_path: Path) -> None:
    run = made(tmp_path)
    changed = ("resume=last", "total_frames=40960", "plugins=[my_nets]", f"logger.root={tmp_path}")
    assert f"resume={run.path} total_frames=40960 'plugins=[my_nets,my_hooks.mine]'" in left(run, ALONE, *changed)
    # A new run has saved all of them.
    assert "total_frames" not in left(run, ALONE, *changed[1:])


def test_on_several_machines_no_single_command_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run, ways = made(tmp_path), []
    for local in ("1", "2"):
        monkeypatch.setenv("LOCAL_WORLD_SIZE", local)
        ways.append(left(run, JoinedRanks(Connection(dist.HashStore(), 0, 2, 60.0))).partition("; ")[2])
    settings = f"resume={run.path} 'plugins=[my_nets,my_hooks.mine]'"
    assert ways == [
        f"start the same torchrun commands on every machine, with {settings} instead of the other settings",
        f"go on with: torchrun --nproc-per-node=2 -m skatemount.train {settings}",
    ]
