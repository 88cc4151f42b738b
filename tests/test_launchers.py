"""Launchers of multiruns: their extra, the cores of each job, and jobs that end with their command."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from holding import HOLD
from hydra import compose, initialize_config_dir
from started import start, wait_for
from tiny import TINY

from skatemount import launchers, multirun
from skatemount.config import config_dir
from skatemount.runs.folder import RunFolder
from skatemount.runs.locks import is_locked
from skatemount.runs.sweep import Job, Score, SweepFolder
from skatemount.utils import cores
from skatemount.utils.cores import CORES


@pytest.fixture
def command(call_program: Callable[..., Any]) -> Callable[..., Any]:
    """Calls the training's program with a verb and arguments; returns status, output and error output."""
    return lambda verb, *arguments: call_program(verb, "train", *arguments)


def no_training(config: Any, overrides: list[str], job: Job | None = None) -> float:
    raise AssertionError


def sweeps(runs_root: Path) -> list[Path]:
    return sorted((runs_root / "skatemount").iterdir())


def test_jobs_that_run_together_share_the_cores(
    command: Callable[..., Any], runs_root: Path, monkeypatch: pytest.MonkeyPatch, fresh_workers: None
) -> None:
    monkeypatch.delenv(CORES, raising=False)

    def share(config: Any, overrides: list[str], job: Any) -> float:
        return Score.of(int(os.environ.get("SKATEMOUNT_CORES", "0")), 10)

    arguments = ["-m", "stage=balance", "seed=1,2"]
    status, out, err = command(share, *arguments, "launcher=joblib", "hydra.launcher.n_jobs=2")
    assert status == 0, out + err
    (sweep,) = sweeps(runs_root)
    records = [json.loads(file.read_text()) for file in sorted((sweep / "jobs").iterdir())]
    alone = launchers.available_cores()
    assert [record["success"] for record in records] == [max(1, alone // 2) / 10] * 2
    assert CORES not in os.environ


@pytest.mark.parametrize(
    ("launcher", "jobs", "expected"),
    [
        ({"_target_": "a.JoblibLauncher", "n_jobs": 2}, 3, 4),
        ({"_target_": "a.JoblibLauncher", "n_jobs": -1}, 3, 2),
        ({"_target_": "a.JoblibLauncher", "n_jobs": -1}, None, 1),
        ({"_target_": "a.JoblibLauncher", "n_jobs": -2}, 100, 1),
        ({"_target_": "a.JoblibLauncher", "n_jobs": 10}, 1, 8),
        ({"_target_": "a.JoblibLauncher", "n_jobs": 4}, 0, 2),
        ({"_target_": "a.LocalLauncher"}, 4, 2),
        ({"_target_": "a.LocalLauncher"}, 100, 1),
        ({"_target_": "a.SlurmLauncher", "cpus_per_task": 5}, 4, 5),
        ({"_target_": "a.SlurmLauncher", "cpus_per_task": None}, 4, None),
        ({"_target_": "a.BasicLauncher"}, 4, None),
    ],
)
def test_a_job_has_its_share_of_eight_cores(
    launcher: dict[str, Any], jobs: int | None, expected: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(launchers, "available_cores", lambda: 8)
    assert launchers.cores_of_job(launcher, jobs) == expected


@pytest.mark.parametrize(
    ("jobs", "count", "expected"),
    [(1, 2, 1), (2, 2, 2), (3, 2, 3), (4, 2, 2), (5, 2, 3), (7, 2, 4), (100, 2, 2), (3, 8, 3), (20, 16, 20), (5, 1, 1)],
)
def test_so_many_jobs_at_a_time_end_all_soonest(jobs: int, count: int, expected: int) -> None:
    assert launchers.jobs_at_a_time(jobs, count) == expected


@pytest.mark.parametrize("count", [1, 2, 3, 8])
def test_jobs_beside_each_other_are_not_slower_than_one_after_the_other(count: int) -> None:
    for jobs in range(count, 40):
        together, left, rounds = launchers.jobs_at_a_time(jobs, count), jobs, 0.0
        assert count <= together <= 2 * count
        while left:
            running = min(together, left)
            rounds, left = rounds + max(1.0, running / count), left - running
        # One after the other, with all cores that work without a loss, they take jobs / count.
        assert rounds - jobs / count < 1 and (jobs >= 2 * count or rounds == jobs / count)


def test_the_number_of_jobs_at_a_time_is_chosen(
    command: Callable[..., Any], runs_root: Path, monkeypatch: pytest.MonkeyPatch, fresh_workers: None
) -> None:
    def at_a_time(config: Any, overrides: list[str], job: Any) -> float:
        from hydra.core.hydra_config import HydraConfig

        return Score.of(HydraConfig.get().launcher.n_jobs, 10)

    monkeypatch.setattr(launchers, "available_cores", lambda: 2)
    status, out, err = command(at_a_time, "-m", "stage=balance", "seed=1,2,3", "launcher=joblib")
    assert status == 0, out + err
    (sweep,) = sweeps(runs_root)
    records = [json.loads(file.read_text()) for file in sorted((sweep / "jobs").iterdir())]
    assert [record["success"] for record in records] == [0.3] * 3


@pytest.mark.parametrize(
    ("settings", "jobs", "expected"),
    [
        (["hydra/launcher=joblib"], 3, ["hydra.launcher.n_jobs=3"]),
        (["launcher=joblib", "hydra.launcher.n_jobs=-1"], 3, []),
        (["launcher=joblib", "++hydra.launcher.n_jobs=5"], 3, []),
        (["launcher=joblib"], None, []),
        (["launcher=joblib"], 0, []),
        (["launcher=submitit_local"], 3, []),
        ([], 3, []),
    ],
)
def test_a_number_of_jobs_that_is_given_stays(
    settings: list[str], jobs: int | None, expected: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(launchers, "available_cores", lambda: 2)
    assert launchers.chosen_settings(settings, jobs) == expected


def test_jobs_of_one_process_have_the_same_share(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(launchers, "_before", None)
    monkeypatch.setattr(cores.os, "sched_getaffinity", lambda process: set(range(16)), raising=False)
    monkeypatch.delenv("LOCAL_WORLD_SIZE", raising=False)
    for given, share in ((None, "8"), ("6", "3")):
        monkeypatch.setattr(launchers, "_before", None)
        monkeypatch.delenv(CORES, raising=False) if given is None else monkeypatch.setenv(CORES, given)
        for _ in range(3):
            launchers.share_cores({"_target_": "a.JoblibLauncher", "n_jobs": 2}, 5)
            assert os.environ[CORES] == share


@pytest.mark.parametrize("launcher", ["joblib", "submitit_local", "submitit_slurm"])
def test_a_launcher_without_its_package_is_one_line(
    launcher: str, command: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(launchers.importlib.util, "find_spec", lambda name: None)
    package = f"hydra-{launcher.partition('_')[0]}-launcher"
    for written in (f"launcher={launcher}", f"hydra/launcher={launcher}"):
        status, _, err = command(no_training, "-m", "stage=balance", "seed=1,2", written)
        said = f"skatemount.train: {written} needs the package {package}: pip install 'skatemount[sweep]'\n"
        assert (status, err) == (2, said)


@pytest.mark.parametrize("launcher", ["joblib", "submitit_local", "submitit_slurm"])
def test_the_ready_launchers_compose(launcher: str, runs_root: Path) -> None:
    pytest.importorskip("hydra_plugins.hydra_submitit_launcher")
    pytest.importorskip("hydra_plugins.hydra_joblib_launcher")
    for program in ("train", "evaluate"):
        with initialize_config_dir(str(config_dir().absolute()), version_base="1.3"):
            config = compose(program, [f"launcher={launcher}"], return_hydra_config=True).hydra.launcher
    assert config._target_.endswith({"b": "JoblibLauncher", "l": "LocalLauncher", "m": "SlurmLauncher"}[launcher[-1]])
    if launcher == "submitit_slurm":
        assert config.cpus_per_task and config.max_num_timeout and config.additional_parameters.requeue is True
        # Or srun would give each task one core.
        assert list(config.setup) == ["export SRUN_CPUS_PER_TASK=$SLURM_CPUS_PER_TASK"]


def test_a_job_waits_while_another_process_trains_it(
    runs_root: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run = runs_root / "run"
    answers = iter([True, True, False])
    monkeypatch.setattr(Job, "cut_off_run", lambda self: run)
    monkeypatch.setattr(multirun, "is_locked", lambda path: path == run and next(answers))
    monkeypatch.setattr(multirun.time, "sleep", lambda seconds: None)
    multirun._wait_for_others(Job(SweepFolder(runs_root, "train"), 1, []))
    assert capsys.readouterr().out.endswith("waits, because another process trains it\n") and not list(answers)


@pytest.mark.slow
def test_a_submitted_multirun_is_stopped_and_goes_on(runs_root: Path) -> None:
    pytest.importorskip("hydra_plugins.hydra_submitit_launcher")
    tiny = [each for each in TINY if not each.startswith(("logger.final", "physics.threads", "torch_threads"))]
    arguments = ["-m", "stage=balance", "init_from=null", "seed=1,2", *tiny, "total_frames=320",
                 "callbacks=[holding:Holds]", "logger.final_episodes=4", "logger.checkpoint_every=5",
                 "launcher=submitit_local"]  # fmt: skip

    hold = runs_root.parent / HOLD
    hold.touch()
    process = start("train", runs_root, *arguments)
    try:
        wait_for(process, runs_root, "*/*/seed=[12]/checkpoints/step_*", 2)
        # The command alone, not its jobs.
        process.send_signal(signal.SIGTERM)
        _, err = process.communicate()
    finally:
        process.kill()
    assert process.returncode == 128 + signal.SIGTERM, err
    assert "; start the same command again: it skips the jobs that have finished" in err
    (sweep,) = sweeps(runs_root)
    left = {seed: RunFolder(sweep / f"seed={seed}").latest for seed in (1, 2)}
    # They ended with it, and saved all iterations.
    assert all(is_locked(sweep / f"seed={seed}") is False for seed in left)
    frames = {seed: int(str(folder).rpartition("_")[2]) for seed, folder in left.items()}
    assert all(0 < each < 320 for each in frames.values())

    hold.unlink()
    process = start("train", runs_root, *arguments)
    out, err = process.communicate()
    assert process.returncode == 0, out + err
    assert sweeps(runs_root) == [sweep] and f"output of the jobs: runs/skatemount/{sweep.name}/.submitit\n" in out
    jobs = json.loads((sweep / "results.json").read_text())["jobs"]
    assert [(job["status"], job["steps"], job["run"]) for job in jobs] == [
        ("finished", 320, "seed=1"),
        ("finished", 320, "seed=2"),
    ]
    logs = "".join(path.read_text() for path in sweep.glob(".submitit/*/*_log.out"))
    assert logs.count("resumes runs/skatemount/") == 2

    # Nothing is left: the jobs are submitted, and skipped.
    process = start("train", runs_root, *arguments)
    out, err = process.communicate()
    assert process.returncode == 0, out + err
    logs = "".join(path.read_text() for path in sweep.glob(".submitit/*/*_log.out"))
    assert logs.count("has finished before, skipped") == 2 and sweeps(runs_root) == [sweep]
