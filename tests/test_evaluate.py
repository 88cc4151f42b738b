"""`python -m skatemount.evaluate`."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from PIL import Image

from skatemount.agents.trained_policy import MODULE, make_policy_card
from skatemount.config import compose, compose_program
from skatemount.config.overrides import prepare
from skatemount.envs.task import MountTask
from skatemount.evaluate import evaluate
from skatemount.models.actor_critic import ActorCritic
from skatemount.runs.checkpoint import save_policy
from skatemount.utils.errors import ConfigError

SHORT = ["episode_length=0.8", "physics.threads=1", "physics.num_worlds=4"]


@pytest.fixture(scope="module")
def policy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    config = compose("balance", ["network.actor=[8]", "network.critic=[8]"])
    task = MountTask(config=config)
    mdp = task.make_mdp(torch.Generator())
    networks = ActorCritic(config.network, mdp.observation.size, mdp.privileged.size)
    path = tmp_path_factory.mktemp("policies") / "tiny.safetensors"
    save_policy(path, {MODULE: networks}, make_policy_card(config, task, frames=4242))
    return path


def run(policy: Path, *overrides: str) -> None:
    given = [f"checkpoint={policy}", "episodes=5", *overrides]
    evaluate(compose_program("evaluate", [*given, *SHORT]), [*given, *SHORT])


def test_prints_a_table_and_writes_the_same(policy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "results" / "a.json"
    run(policy, f"json={out}", "suite=mount-fixed")
    printed = capsys.readouterr().out
    document = json.loads(out.read_text())
    assert document.keys() == {
        "episodes", "success", "time_to_mount", "feet_on_board", "board_displacement", "slips", "energy", "failures",
        "failed_episodes", "evaluated",
    }  # fmt: skip
    assert document["episodes"] == 5
    assert document["success"].keys() == {"rate", "low", "high"}
    assert document["time_to_mount"].keys() == {"median", "p95"}
    evaluated = document["evaluated"]
    assert (evaluated["checkpoint"], evaluated["suite"], evaluated["frames"]) == ("tiny", "mount-fixed", 4242)
    assert evaluated["overrides"] == SHORT
    assert evaluated["versions"]["mujoco"]
    assert "tiny on mount-fixed" in printed
    # Each failure is listed, with what films it.
    failed = document["failed_episodes"]
    assert len(failed) == 5 - round(document["success"]["rate"] * 5) > 0
    assert (
        f"suite=mount-fixed episode_length=0.8 physics.threads=1 physics.num_worlds=4 episode={failed[0]['episode']}"
        in printed
    )
    assert f"{document['success']['rate']:.1%}" in printed
    assert str(out) in printed


def test_the_seed_decides_and_is_not_a_trainings(policy: Path, tmp_path: Path) -> None:
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        run(policy, f"json={tmp_path / name}.json", f"seed={seed}")
    a, b, c = (json.loads((tmp_path / f"{name}.json").read_text()) for name in "abc")
    assert a == b
    assert (a["evaluated"]["seed"], c["evaluated"]["seed"]) == (0, 1)
    assert a["energy"] != c["energy"]


def test_several_suites_are_a_table_and_one_document(
    policy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run(policy, f"json={tmp_path}/all.json", "suite=all", "suite.members=[balance-fixed,rolling]")
    printed = capsys.readouterr().out
    document = json.loads((tmp_path / "all.json").read_text())
    assert list(document["suites"]) == ["balance-fixed", "rolling"]
    for name, result in document["suites"].items():
        assert f"{name} (" in printed
        assert f"{result['success']['rate']:.1%}" in printed
        assert result["evaluated"]["suite"] == name
    assert "main failure" in printed


def test_output_is_a_folder_of_results_and_success_maps(policy: Path, tmp_path: Path) -> None:
    run(policy, f"output={tmp_path}/results", "suite=mount-fixed", "seed=3", f"json={tmp_path}/one.json")
    made = sorted(path.name for path in (tmp_path / "results").iterdir())
    assert made == ["tiny_mount-fixed_seed3.json", "tiny_mount-fixed_seed3.png"]
    assert (tmp_path / "results" / made[0]).read_text() == (tmp_path / "one.json").read_text()
    with Image.open(tmp_path / "results" / made[1]) as picture:
        assert picture.format == "PNG" and picture.width > 800


def test_a_mistake_is_one_line(policy: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "skatemount.evaluate", f"checkpoint={policy}", "suite=walk"]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
    assert result.returncode == 2
    assert result.stderr == (
        "skatemount.evaluate: suite=walk: there is no suite walk; there are: all, approach-fixed, approach-unfixed, "
        "balance-fixed, far, gait, low-friction, mount-fixed, mount-unfixed, other-boards, pushed, rolling\n"
    )
    assert result.stdout == ""


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["-m", "suite=far,fra"], "there is no suite fra; there are: all, "),
        (["suite=null"], "suite=null: leave suite out for the task that the policy was trained in"),
    ],
)
def test_suites_are_looked_up_before_anything_runs(arguments: list[str], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        prepare([each for each in arguments if each != "-m"], "evaluate")
