"""`python -m skatemount.evaluate`."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
from PIL import Image

from skatemount.agents.trained_policy import MODULE, make_policy_card
from skatemount.config import compose, compose_program
from skatemount.config.files import choices
from skatemount.config.overrides import prepare
from skatemount.envs.task import MountTask
from skatemount.envs.tasks import TASKS
from skatemount.evaluate import evaluate, film_commands
from skatemount.evaluation.records import EpisodeRecords
from skatemount.evaluation.results import Evaluation
from skatemount.evaluation.suite_task import EvaluationTask, load_suite
from skatemount.models.actor_critic import ActorCritic
from skatemount.runs.checkpoint import save_policy
from skatemount.utils.errors import ConfigError

SHORT = ["episode_length=0.8", "physics.threads=1", "physics.num_worlds=4"]


@pytest.fixture(scope="module")
def policy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    config = compose("balance", ["network.actor=[8]", "network.critic=[8]"])
    task = MountTask(config=config)
    mdp = task.make_mdp(torch.Generator())
    networks = ActorCritic(config.network, mdp.observation.size, mdp.privileged.size, mdp.context.layout.num_joints)
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
    changes = ["episode_length=0.8", "physics.num_worlds=4"]
    assert evaluated["changed_by"] == changes
    assert evaluated["versions"]["mujoco"]
    assert (
        f"tiny on mount-fixed, version {load_suite('mount-fixed').version}, changed by {', '.join(changes)}" in printed
    )
    assert [line.split() for line in printed.splitlines() if line.startswith(" changed by")] == [
        ["changed", "by", each] for each in changes
    ]
    # Each failure is listed, and the last line films one.
    failed = document["failed_episodes"]
    assert len(failed) == 5 - round(document["success"]["rate"] * 5) > 0
    command = "suite=mount-fixed episode_length=0.8 physics.threads=1 physics.num_worlds=4"
    assert f"{command} episode={failed[0]['episode']}" in printed.splitlines()[-1]
    assert printed.splitlines()[-1].startswith("film a failure: python -m skatemount.record ")
    assert f"{document['success']['rate']:.1%}" in printed
    assert str(out) in printed


def test_late_targets_and_noisy_sensors_change_the_results_and_are_told(policy: Path, tmp_path: Path) -> None:
    late = ["sensing=default", "sensing.target_delay=[0.04,0.04]"]
    for name, given in (("a", []), ("b", late)):
        run(policy, f"json={tmp_path / name}.json", "suite=mount-fixed", *given)
    a, b = (json.loads((tmp_path / f"{name}.json").read_text()) for name in "ab")
    assert b["evaluated"]["overrides"] == [*late, *SHORT]
    assert "sensing=default 'sensing.target_delay=[0.04,0.04]'" in b["evaluated"]["record"]
    # The same starts, other motions.
    assert [each["start"] for each in a["failed_episodes"]][0] == [each["start"] for each in b["failed_episodes"]][0]
    assert a["energy"] != b["energy"]


def test_a_ladder_is_told_in_the_table_the_document_and_a_picture(
    policy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    members = ["suite=all", "suite.members=[pushed,far]"]
    run(policy, *members, "episodes=3", f"json={tmp_path / 'a.json'}", f"output={tmp_path}")
    printed = capsys.readouterr().out
    suites = json.loads((tmp_path / "a.json").read_text())["suites"]
    document = suites["pushed"]["ladder"]
    assert (document["quantity"], document["unit"], document["falls_at"]) == ("largest push", "m/s", "0.25")
    assert [step["name"] for step in document["steps"]] == ["0.25", "0.5", "0.75"]
    assert "ladder" not in suites["far"]
    (row,) = (line.split() for line in printed.splitlines() if line.split()[:3] == ["pushed", "0.25", "m/s"])
    assert row[-6:] == ["falls", "below", "0.90", "at", "0.25", "m/s"]
    with Image.open(tmp_path / "tiny_pushed_seed0_ladder.png") as picture:
        assert picture.width > 300
    assert not (tmp_path / "tiny_far_seed0_ladder.png").exists()


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
    assert "tiny, 5 episodes of each suite, changed by episode_length=0.8, physics.num_worlds=4" in printed
    # The failure is of the suite with the lowest success rate.
    rates = {name: result["success"]["rate"] for name, result in document["suites"].items()}
    worst = min(rates, key=lambda name: rates[name])
    (film,) = (line for line in printed.splitlines() if line.startswith("film a failure: "))
    number = document["suites"][worst]["failed_episodes"][0]["episode"]
    assert f"suite={worst} " in film and film.endswith(f" episode={number}")


class Broken(io.StringIO):
    """A pipe whose reader has gone."""

    def write(self, text: str) -> int:
        raise BrokenPipeError


def test_files_are_written_before_anything_is_printed(
    policy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stdout", Broken())
    with pytest.raises(BrokenPipeError):
        run(policy, f"json={tmp_path}/one.json", f"output={tmp_path}/results", "suite=mount-fixed")
    assert json.loads((tmp_path / "one.json").read_text())["episodes"] == 5
    assert len(list((tmp_path / "results").iterdir())) == 2


def test_the_next_commands_film_a_failure_and_a_success(policy: Path) -> None:
    asked = [f"checkpoint={policy}", "suite=all", "suite.members=[balance-fixed,rolling]"]
    tasks = EvaluationTask.prepare(compose_program("evaluate", asked), asked)

    def result(*success: int) -> Evaluation:
        tensors: dict[str, Any] = {name: torch.zeros(len(success)) for name in EpisodeRecords.__annotations__}
        tensors["metrics"] = {metric.name: torch.zeros(len(success)) for metric in TASKS.get("mount").metrics}
        tensors["start"] = torch.zeros(len(success), 3)
        tensors |= {name: torch.zeros(len(success), dtype=torch.int64) for name in ("variant", "end")}
        tensors |= {"number": torch.arange(len(success)), "success": torch.tensor(success) > 0}
        return Evaluation(EpisodeRecords(**tensors), ["not_mounted"], TASKS.get("mount"))

    commands = film_commands(tasks, {"balance-fixed": result(1, 1, 0), "rolling": result(1, 0, 0)})
    assert "suite=rolling" in commands["film a failure"] and commands["film a failure"].endswith("episode=1")
    assert commands["film the first success"] == tasks[0].record_command(0)
    assert list(film_commands(tasks, {"balance-fixed": result(0), "rolling": result(0)})) == ["film a failure"]
    assert list(film_commands(tasks, {"balance-fixed": result(1), "rolling": result(1)})) == ["film the first success"]


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
    there_are = ", ".join(sorted(choices("suite")))
    assert result.stderr == (
        f"skatemount.evaluate: suite=walk: there is no suite walk; there are: {there_are}; "
        "a suite of your own needs --config-dir <folder>\n"
    )
    assert result.stdout == ""


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["-m", "suite=far,fra"], "there is no suite fra "),
        (["suite=null"], "suite=null: leave suite out for the task that the policy was trained in"),
    ],
)
def test_suites_are_looked_up_before_anything_runs(arguments: list[str], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        prepare([each for each in arguments if each != "-m"], "evaluate")
