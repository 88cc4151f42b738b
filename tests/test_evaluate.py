"""`python -m skatemount.evaluate`."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from skatemount.agent import MODULE, make_card
from skatemount.checkpoint import save_policy
from skatemount.config import compose
from skatemount.envs.task import MountTask
from skatemount.evaluate import evaluate
from skatemount.models import ActorCritic

SHORT = ["episode_length=0.8", "physics.threads=1", "physics.num_worlds=4"]


@pytest.fixture(scope="module")
def policy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    config = compose("balance", ["network.actor=[8]", "network.critic=[8]"])
    task = MountTask(config=config)
    mdp = task.make_mdp(torch.Generator())
    networks = ActorCritic(config.network, mdp.observation.size, mdp.privileged.size)
    path = tmp_path_factory.mktemp("policies") / "tiny.safetensors"
    save_policy(path, {MODULE: networks}, make_card(config, task, frames=4242))
    return path


def run(policy: Path, *overrides: str) -> None:
    given = [f"checkpoint={policy}", "episodes=5", *overrides]
    evaluate(compose(None, [*given, "torch_threads=1", *SHORT]), [*given, *SHORT])


def test_prints_a_table_and_writes_the_same(policy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "results" / "a.json"
    run(policy, f"json={out}", "suite=mount")
    printed = capsys.readouterr().out
    document = json.loads(out.read_text())
    assert document.keys() == {
        "episodes", "success", "feet_on_board", "time_to_mount", "ended", "evaluated",
    }  # fmt: skip
    assert document["episodes"] == 5
    assert document["success"].keys() == {"rate", "low", "high"}
    assert document["time_to_mount"].keys() == {"median", "p95"}
    evaluated = document["evaluated"]
    assert (evaluated["checkpoint"], evaluated["suite"], evaluated["frames"]) == ("tiny", "mount", 4242)
    assert evaluated["overrides"] == SHORT
    assert evaluated["versions"]["mujoco"]
    assert "tiny on mount" in printed
    assert f"{document['success']['rate']:.1%}" in printed
    assert str(out) in printed


def test_the_seed_decides_and_is_not_a_trainings(policy: Path, tmp_path: Path) -> None:
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        run(policy, f"json={tmp_path / name}.json", f"seed={seed}")
    a, b, c = (json.loads((tmp_path / f"{name}.json").read_text()) for name in "abc")
    assert a == b
    assert c["evaluated"]["seed"] == a["evaluated"]["seed"] + 1
    assert a["evaluated"]["seed"] >= 1_000_000


def test_a_mistake_is_one_line(policy: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "skatemount.evaluate", f"checkpoint={policy}", "suite=walk"]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
    assert result.returncode == 2
    assert result.stderr == (
        "skatemount.evaluate: suite=walk is not a suite; there are: approach, balance, forward, gait, mount, unfixed\n"
    )
    assert result.stdout == ""
