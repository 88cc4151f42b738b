"""Several ranks: they keep the same weights, learn what one process learns, resume exactly, and notice a lost rank."""

from __future__ import annotations

import json
import os
import re
import shlex
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
from namespaces import ADDRESSES, two_machines
from rank_callbacks import HandsOver
from tiny import BATCH, TINY

from skatemount.agents.trained_policy import MODULE
from skatemount.config import compose
from skatemount.runs.checkpoint import load_policy, load_training_state, load_world_state, step_folder
from skatemount.runs.folder import RunFolder
from skatemount.runs.metrics import STEP
from skatemount.training.agreement import MAY_DIFFER
from skatemount.training.resume import resume_config
from skatemount.training.trainer import Trainer

HERE = Path(__file__).parents[1]
BOTH = 2 * BATCH
"""Environment steps of one iteration of two ranks."""

LIVELY = ["episode_length=0.3", "randomization.push_interval=[0.05,0.2]", "randomization.push_velocity=[-0.5,0.5]"]
QUIET = [*TINY, "logger.tensorboard=false", "logger.progress_every=1e6"]
QUIET += ["distributed.check_every=1", "physics.device=cpu"]
SAME = ["algorithm.epochs=1", "algorithm.minibatches=1", "callbacks=[rank_callbacks:HandsOver]", "stage=balance"]
# Otherwise some processors round the products to three digits, and not the same for batches of another size.
SAME += ["precision=highest"]
AUTO = [*LIVELY, "stage=unfixed", "curriculum=auto", "init_from=null", "seed=4"]
STUCK = "curriculum.stuck_start_fraction=0.5"


def free_port() -> int:
    """Return a port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def torchrun(*arguments: str, ranks: int = 2, status: int = 0) -> subprocess.CompletedProcess[str]:
    """Run a command in as many processes, and check its exit status."""
    options = [f"--nproc-per-node={ranks}", f"--master-port={free_port()}"]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(HERE), os.environ.get("PYTHONPATH", "")])}
    command = [sys.executable, "-W", "ignore", "-m", "torch.distributed.run", *options, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=3600)
    assert done.returncode == status, done.stdout[-2000:] + done.stderr[-4000:]
    return done


def weights(run: RunFolder) -> dict[str, torch.Tensor]:
    """Return the weights and statistics of a run's latest policy."""
    assert run.latest is not None
    return load_policy(run.latest)[0][MODULE]


def state_of(run: RunFolder) -> dict[str, Any]:
    """Return the training state of a run's latest checkpoint."""
    assert run.latest is not None
    return load_training_state(run.latest)


def left_by(run: RunFolder) -> dict[str, Any]:
    """Return everything in a run's latest checkpoint but the clock, by path."""
    assert run.latest is not None
    state = {"training": state_of(run), "worlds": load_world_state(run.latest)}
    leaves: dict[str, Any] = {}

    def add(value: Any, where: str) -> None:
        if isinstance(value, dict):
            for key, part in value.items():
                add(part, f"{where}/{key}")
        else:
            leaves[where] = value.nan_to_num(1e30).tolist() if isinstance(value, torch.Tensor) else value

    add(state, "")
    del leaves["/training/progress/elapsed"]
    return leaves


def rows(run: RunFolder) -> list[dict[str, float]]:
    return [json.loads(line) for line in run.metrics_file.read_text().splitlines()]


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("ranks")


@pytest.fixture(scope="module")
def alone(root: Path) -> RunFolder:
    """Run one process with the worlds of two ranks for one iteration, which writes its batch."""
    twice = [each.replace("num_worlds=8", "num_worlds=16") for each in QUIET]
    given = [*twice, *SAME, f"total_frames={BOTH}", f"logger.root={root}", "logger.experiment=alone"]
    trainer = Trainer(compose(None, given), given)
    trainer.train()
    trainer.close()
    return trainer.run


@pytest.fixture(scope="module")
def runs(root: Path, alone: RunFolder) -> dict[str, RunFolder]:
    """Run two ranks that train one after the other what the tests look at."""
    trainings = {
        "same": [*SAME, f"total_frames={BOTH}"],
        "whole": [*AUTO, STUCK, f"total_frames={6 * BOTH}"],
        "half": [*AUTO, STUCK, f"total_frames={6 * BOTH}", "callbacks=[rank_callbacks:Stops]"],
        "resumed": ["resume=LAST"],
        "warp": ["stage=balance", "physics=warp", f"total_frames={2 * BOTH}"],
        "poisoned": ["stage=balance", "callbacks=[rank_callbacks:Poisoned]", f"total_frames={4 * BOTH}"],
    }
    path = root / "trainings.json"
    common = [f"logger.root={root}"]
    given = [
        [*settings, *common] if name == "resumed" else [*QUIET, *settings, *common, f"logger.name={name}"]
        for name, settings in trainings.items()
    ]
    path.write_text(json.dumps(given))
    torchrun(str(HERE / "rank_program.py"), str(path))
    folders = json.loads(path.with_suffix(".runs").read_text())
    return {name: RunFolder.open(folder) for name, folder in zip(trainings, folders)}


@pytest.mark.slow
def test_two_ranks_make_the_first_update_of_one_process(alone: RunFolder, runs: dict[str, RunFolder]) -> None:
    assert (alone.path.parents[1] / HandsOver.file).is_file()
    one, two = weights(alone), weights(runs["same"])
    assert one.keys() == two.keys()
    for name, value in one.items():
        torch.testing.assert_close(
            two[name], value, rtol=2e-5, atol=2e-6, msg=lambda text, name=name: f"{name}: {text}"
        )
    # The first step of Adam is as large as the learning rate in every weight, so it would hide a wrong scale.
    moments = [state_of(run)["ppo"]["optimizer"] for run in (alone, runs["same"])]
    for name, state in moments[0].items():
        torch.testing.assert_close(moments[1][name]["exp_avg"], state["exp_avg"], rtol=1e-3, atol=1e-7)
    first, second = rows(alone)[-1], rows(runs["same"])[-1]
    for name in ("Loss/kl", "Loss/learning_rate", "Loss/value_function", "Loss/surrogate", "Loss/entropy"):
        assert second[name] == pytest.approx(first[name], rel=1e-3, abs=1e-6), name


@pytest.mark.slow
def test_a_resumed_run_of_two_ranks_equals_one_that_was_not_ended(runs: dict[str, RunFolder]) -> None:
    whole, resumed = left_by(runs["whole"]), left_by(runs["resumed"])
    assert [row[STEP] for row in rows(runs["resumed"])] == [i * BOTH for i in range(1, 7)]
    assert (runs["half"].checkpoints / step_folder(3 * BOTH)).is_dir()
    assert whole.keys() == resumed.keys()
    assert [name for name in whole if whole[name] != resumed[name]] == []
    assert "/worlds/ranks/1/worlds/env/physics" in {name.rpartition("/")[0] for name in whole}
    assert whole["/training/progress/ranks"] == 2


@pytest.mark.slow
def test_every_rank_counts(runs: dict[str, RunFolder]) -> None:
    """All frames are counted, the curriculum has the episodes of both ranks, and rank 1 has worlds of its own."""
    last = rows(runs["whole"])[-1]
    assert last[STEP] == 6 * BOTH
    assert last["Perf/reduced_megabytes"] > 0
    state = left_by(runs["whole"])
    own, other = (state[f"/worlds{prefix}/env/generator"] for prefix in ("", "/ranks/1/worlds"))
    assert own != other
    counted = sum(state["/training/curriculum/trials"])
    # 16 worlds of 24 steps with episodes of at most 8 steps; the first episodes have no bin.
    assert counted > 16


@pytest.mark.slow
def test_a_bad_batch_on_one_rank_is_undone_on_all(runs: dict[str, RunFolder]) -> None:
    metrics = rows(runs["poisoned"])
    assert [row["Train/undone_updates"] for row in metrics] == [0, 0, 1, 1]
    assert all(bool(value.isfinite().all()) for value in weights(runs["poisoned"]).values())


@pytest.mark.slow
def test_two_ranks_on_the_engine_for_gpus(runs: dict[str, RunFolder]) -> None:
    assert runs["warp"].config["physics"]["engine"] == "warp"
    assert [row[STEP] for row in rows(runs["warp"])] == [BOTH, 2 * BOTH]
    state = left_by(runs["warp"])
    assert state["/training/progress/ranks"] == 2
    own, other = (state[f"/worlds{prefix}/env/privileged"] for prefix in ("", "/ranks/1/worlds"))
    assert own != other and torch.tensor([own, other]).isfinite().all()


@pytest.mark.slow
def test_one_process_resumes_what_two_ranks_saved(
    runs: dict[str, RunFolder], root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = runs["whole"]
    before = weights(run)
    given = [f"resume={run.path}", f"logger.root={root}", f"total_frames={7 * BOTH}"]
    trainer = Trainer(resume_config(compose(None, given), given), given)
    try:
        assert "number of ranks 2 when it was saved, 1 now" in capsys.readouterr().out
        now = trainer.networks.state_dict()
        assert all(torch.equal(now[name], value) for name, value in before.items())
        trainer.train()
    finally:
        trainer.close()
    assert trainer.frames == 7 * BOTH
    assert "ranks" not in state_of(run)["progress"]


def command(root: Path, callback: str, iterations: int = 4) -> list[str]:
    given = [*QUIET, "stage=balance", f"total_frames={iterations * BOTH}", "logger.checkpoint_every=1"]
    return ["-m", "skatemount.train", *given, f"logger.root={root}", f"callbacks=[rank_callbacks:{callback}]"]


def the_run(root: Path) -> RunFolder:
    (path,) = (each for each in (root / "skatemount").iterdir() if each.is_dir())
    return RunFolder.open(path)


@pytest.mark.slow
def test_a_killed_rank_is_named_and_torchrun_goes_on_from_the_last_checkpoint(tmp_path: Path) -> None:
    done = torchrun("--max-restarts=1", *command(tmp_path, "Killed"))
    assert re.search(r"skatemount\.train: rank 1 of 2 has ended.*128 steps are saved in .*go on with: ", done.stderr)
    assert f"restarted: resumes {the_run(tmp_path).path}" in done.stdout
    assert [row[STEP] for row in rows(the_run(tmp_path))] == [BOTH, 2 * BOTH, 3 * BOTH, 4 * BOTH]


@pytest.mark.slow
def test_a_restart_of_a_resumed_run_keeps_the_settings_of_the_command_line(tmp_path: Path) -> None:
    torchrun(*command(tmp_path, "KilledLater", iterations=2))
    run = the_run(tmp_path)
    given = [f"resume={run.path}", f"logger.root={tmp_path}", f"total_frames={6 * BOTH}"]
    done = torchrun("--max-restarts=1", "-m", "skatemount.train", *given)
    # The saved settings have another number.
    assert re.search(rf"256 steps are saved in .*; go on with: .* total_frames={6 * BOTH} ", done.stderr)
    assert f"restarted: resumes {run.path}" in done.stdout
    assert [row[STEP] for row in rows(run)] == [i * BOTH for i in range(1, 7)]


@pytest.mark.slow
def test_a_restart_in_the_final_evaluation_only_evaluates(tmp_path: Path) -> None:
    done = torchrun("--max-restarts=1", *command(tmp_path, "KilledAtEnd", iterations=2), "logger.final_episodes=2")
    run = the_run(tmp_path)
    assert f"restarted: resumes {run.path}" in done.stdout, done.stdout
    assert re.search(r"episodes +2\n", done.stdout)
    assert "are already trained" not in done.stderr and rows(run)[-1][STEP] == 2 * BOTH
    # The second time it is a mistake of the user's, which only rank 0 reports.
    again = ["--max-restarts=1", "-m", "skatemount.train", f"resume={run.path}", f"logger.root={tmp_path}"]
    assert torchrun(*again, status=1).stderr.count("skatemount.train: total_frames=128: 128 frames are already") == 2


@pytest.mark.slow
def test_a_rank_that_stands_still_ends_the_run_after_the_timeout(tmp_path: Path) -> None:
    done = torchrun(*command(tmp_path, "Stopped"), "distributed.timeout=5", status=1)
    assert "rank 1 of 2 has ended, or did not answer within 5 s; 128 steps are saved in" in done.stderr


@pytest.mark.slow
def test_a_signal_to_one_rank_ends_all_after_the_same_iteration(tmp_path: Path) -> None:
    errors = torchrun(*command(tmp_path, "AskedToEnd"), status=1).stderr
    assert re.search(r"ended by SIGTERM; 192 steps are saved in .*; go on with: torchrun --nproc-per-node=2 ", errors)
    run = the_run(tmp_path)
    assert state_of(run)["progress"] | {"elapsed": 0} == {
        "frames": 3 * BOTH, "iteration": 3, "elapsed": 0, "device": "cpu", "ranks": 2,
    }  # fmt: skip


@pytest.mark.slow
def test_a_signal_ends_an_evaluation_so_that_the_iteration_is_saved(tmp_path: Path) -> None:
    done = torchrun(*command(tmp_path, "AskedToEndInEvaluation"), status=1)
    assert "ended by SIGTERM; 64 steps are saved in " in done.stderr
    assert [row[STEP] for row in rows(the_run(tmp_path))] == [BOTH]


@pytest.mark.slow
def test_weights_that_differ_end_the_run(tmp_path: Path) -> None:
    done = torchrun(*command(tmp_path, "Drifts"), status=1)
    assert "the weights of rank 1 differ from those of rank 0" in done.stderr


@pytest.mark.slow
def test_ranks_with_other_settings_are_refused(tmp_path: Path) -> None:
    given = " ".join([*QUIET, "stage=balance", f"logger.root={tmp_path}", "seed=$RANK"])
    done = torchrun("--no-python", "bash", "-c", f"{sys.executable} -m skatemount.train {given}", status=1)
    assert "skatemount.train: seed=1 on rank 1, but 0 on rank 0; start all ranks with the same" in done.stderr
    assert done.stderr.count("skatemount.train: ") == 1 and not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_group_that_differs_is_named_and_not_what_its_file_sets(tmp_path: Path) -> None:
    given = " ".join([*QUIET, "stage=balance", f"logger.root={tmp_path}"])
    script = f"if [ $RANK = 1 ]; then given=board=mini; fi; {sys.executable} -m skatemount.train {given} $given"
    done = torchrun("--no-python", "bash", "-c", script, status=1)
    assert "skatemount.train: board=mini on rank 1, but not on rank 0; start all ranks" in done.stderr


def commands_of_the_docs(repo_root: Path, root: Path, address: str, port: int) -> list[list[str]]:
    """Return the two commands as they stand there, but for the address, the port, and a smaller training."""
    page = (repo_root / "docs" / "scale.md").read_text(encoding="utf-8")
    section = page[page.index("## Two laptops") : page.index("## One machine")]
    found = [each.replace("\\\n", " ") for each in re.findall(r"\$ (torchrun(?:.*\\\n)*.*)", section)]
    assert [command.count(f"--node-rank={rank}") for rank, command in enumerate(found)] == [1, 1]
    smaller = [*QUIET, f"total_frames={2 * BOTH}", f"logger.root={root}"]
    given = {each.partition("=")[0] for each in smaller}
    launcher = [sys.executable, "-W", "ignore", "-m", "torch.distributed.run"]
    commands = []
    for command in found:
        words = shlex.split(command.replace("192.168.1.10", address).replace("29500", str(port)))
        assert words.pop(0) == "torchrun" and f"--master-addr={address}" in words
        commands.append([*launcher, *(word for word in words if word.partition("=")[0] not in given), *smaller])
    return commands


def check_two_machines(commands: list[list[str]], root: Path, address: str) -> None:
    """Run a command on each of two machines, and check what they print and train."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    nodes = [subprocess.Popen(command, text=True, cwd=root, **pipes) for command in commands]
    printed = []
    for node in nodes:
        output, errors = node.communicate(timeout=3600)
        assert node.returncode == 0, errors[-4000:]
        printed.append(output)
    assert f"rank 1 of 2 has joined; rank 0 at {address} shows the progress" in printed[1]
    assert "has joined" not in printed[0]
    run = the_run(root)
    assert state_of(run)["progress"]["ranks"] == 2 and rows(run)[-1][STEP] == 2 * BOTH


@pytest.mark.slow
def test_the_commands_of_two_machines_in_the_docs(tmp_path: Path, repo_root: Path) -> None:
    commands = commands_of_the_docs(repo_root, tmp_path, "127.0.0.2", free_port())
    check_two_machines(commands, tmp_path, "127.0.0.2")


@pytest.mark.slow
def test_the_commands_of_the_docs_in_two_networks(tmp_path: Path, repo_root: Path) -> None:
    """As on two machines, the second process reaches the first through a network only."""
    with two_machines() as enter:
        commands = commands_of_the_docs(repo_root, tmp_path, ADDRESSES[0], 29500)
        commands = [[*there, *command] for there, command in zip(enter, commands)]
        check_two_machines(commands, tmp_path, ADDRESSES[0])


def test_the_docs_name_all_that_may_differ(repo_root: Path) -> None:
    page = (repo_root / "docs" / "scale.md").read_text(encoding="utf-8")
    listed = page[page.index("Only these may differ:") :].split("\n\n")[0]
    # What is resumed is said elsewhere: only rank 0 needs it.
    assert [each for each in MAY_DIFFER if each != "resume" and f"`{each}" not in listed] == []


@pytest.mark.slow
@pytest.mark.nightly
def test_four_ranks_keep_the_same_weights_for_100_iterations(tmp_path: Path) -> None:
    """The weights are compared after every iteration, and a difference ends the run."""
    given = [*QUIET, *AUTO, f"total_frames={100 * 4 * BATCH}", f"logger.root={tmp_path}"]
    torchrun("-m", "skatemount.train", *given, ranks=4)
    assert len(rows(the_run(tmp_path))) == 100
    assert state_of(the_run(tmp_path))["progress"]["ranks"] == 4


@pytest.mark.slow
@pytest.mark.nightly
def test_two_ranks_train_a_chain_of_stages(tmp_path: Path) -> None:
    given = [*QUIET, "curriculum=paper", f"total_frames={12 * BOTH}", f"logger.root={tmp_path}"]
    done = torchrun("-m", "skatemount.train", *given, "logger.evaluate_every=1000", "logger.evaluate_episodes=1")
    parts = the_run(tmp_path).parts
    assert len(parts) >= 3 and all(rows(part) for part in parts), done.stdout
    assert all(state_of(part)["progress"]["ranks"] == 2 for part in parts)
