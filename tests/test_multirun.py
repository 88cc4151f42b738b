"""Multiruns: every job runs, whatever becomes of the others."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from holding import HOLD
from started import start, wait_for
from tiny import BATCH, TINY

from skatemount import multirun
from skatemount.multirun import separate_files
from skatemount.runs.checkpoint import POLICY_FILE, PolicyCard, save_policy
from skatemount.runs.find import find_checkpoint
from skatemount.runs.folder import RunFolder
from skatemount.runs.sweep import Job, Score, SweepFolder
from skatemount.train import _of_job, train
from skatemount.training.callbacks import CheckpointCallback
from skatemount.training.trainer import Trainer
from skatemount.utils.errors import ConfigError

pytestmark = pytest.mark.usefixtures("no_pictures")

Verb = Callable[..., Any]


def scores(config: Any, overrides: list[str], job: Job | None = None) -> float:
    """Stands for a training: its success is a tenth of the seed."""
    if config.seed == 7:
        raise ZeroDivisionError("seven")
    if config.physics.num_worlds == 9:
        raise ConfigError("physics.num_worlds=9 is odd")
    print(f"works on {config.seed}", flush=True)
    return Score.of(config.seed, 10, frames=1000)


def test_several_ranks_cannot_start_one(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"RANK": "0", "WORLD_SIZE": "2", "MASTER_ADDR": "localhost"}.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(ConfigError, match="^-m cannot be started by torchrun with several ranks"):
        multirun.run(scores, "train", ["seed=1,2"])


@pytest.fixture
def command(call_program: Callable[..., Any]) -> Callable[..., Any]:
    """Calls a program with arguments; returns status, output and error output."""
    return lambda verb, *arguments, program="train": call_program(verb, program, *arguments)


def sweeps(runs_root: Path) -> list[Path]:
    return sorted((runs_root / "skatemount").iterdir())


def test_a_failing_job_does_not_end_the_others(command: Callable[..., Any], runs_root: Path) -> None:
    arguments = ["-m", "stage=balance", "physics.num_worlds=8,9", "seed=1,2"]
    status, out, err = command(scores, *arguments)
    assert status == 1
    assert out.count("works on") == 2 and "job 2 of 4: physics.num_worlds=8 seed=2\n" in out
    reason = "physics.num_worlds=9 seed=1: failed: physics.num_worlds=9 is odd"
    assert err.splitlines()[-2] == f"skatemount.train: job 3 of 4: {reason}"
    assert "Traceback" not in err
    (sweep,) = sweeps(runs_root)
    document = json.loads((sweep / "results.json").read_text())
    assert [job["status"] for job in document["jobs"]] == ["finished", "finished", "failed", "failed"]
    assert document["jobs"][1]["success"] == 0.2 and document["jobs"][1]["low"] < 0.2 < document["jobs"][1]["high"]
    assert document["over_seeds"][0] == {
        "settings": {"physics.num_worlds": "8"}, "seeds": 2, "finished": 2, "mean": pytest.approx(0.15),
        "least": 0.1, "greatest": 0.2,
    }  # fmt: skip
    assert (sweep / "multirun.yaml").is_file() and "15.0%" in out
    assert f"sweep: runs/skatemount/{sweep.name}\n" in out

    # The same command again: nothing is left but what failed.
    status, out, err = command(scores, *arguments)
    assert (status, sweeps(runs_root)) == (1, [sweep])
    assert out.count("works on") == 0 and out.count("has finished before, skipped") == 2
    assert "repeated, it failed before: physics.num_worlds=9 is odd" in out


def test_wrong_settings_of_any_job_end_the_sweep_before_it_starts(command: Callable[..., Any], runs_root: Path) -> None:
    status, out, err = command(scores, "-m", "stage=balance", "physics.num_worlds=8,0", "seed=-1,2")
    assert status == 2 and "works on" not in out and list(runs_root.glob("*/*")) == []
    assert err.splitlines() == [
        "skatemount.train: job 1 of 4: physics.num_worlds=8 seed=-1: seed=-1 must be 0 or more",
        "skatemount.train: job 3 of 4: physics.num_worlds=0 seed=-1: seed=-1 must be 0 or more",
        "skatemount.train: job 4 of 4: physics.num_worlds=0 seed=2: physics.num_worlds=0 must be from 1 to 1000000",
        "skatemount.train: nothing was started",
    ]
    # What is wrong in all jobs is said once.
    status, _, err = command(scores, "-m", "stage=balance", "physics.num_worlds=0", "seed=1,2")
    assert (status, err) == (2, "skatemount.train: physics.num_worlds=0 must be from 1 to 1000000\n")
    status, _, err = command(scores, "-m", "seed=1,2")
    assert status == 2 and err.startswith("skatemount.train: no stage: give stage=<name>, one of anywhere,")
    status, _, err = command(scores, "-m", "plugins=[no_such],[]", "stage=balance")
    assert status == 1 and "failed: plugins=[no_such]: there is no module no_such" in err


def test_an_unexpected_error_is_shown_and_the_others_run(command: Callable[..., Any]) -> None:
    status, out, err = command(scores, "-m", "stage=balance", "seed=7,2")
    assert status == 1 and "works on 2" in out
    assert "Traceback" in err and err.endswith("job 1 of 2: seed=7: failed: ZeroDivisionError: seven\n")


def test_every_command_and_every_start_afresh_has_its_folder(command: Callable[..., Any], runs_root: Path) -> None:
    command(scores, "-m", "stage=balance", "seed=1,2")
    command(scores, "-m", "stage=balance", "seed=1,2,3")
    assert len(sweeps(runs_root)) == 2
    command(scores, "-m", "stage=balance", "seed=1,2", "torch_threads=1")  # trains the same
    assert len(sweeps(runs_root)) == 2
    _, out, _ = command(scores, "-m", "stage=balance", "seed=1,2", "logger.experiment=other")
    assert out.count("works on") == 2 and len(list((runs_root / "other").iterdir())) == 1


def test_a_mistake_in_all_jobs_leaves_no_folder(command: Callable[..., Any], runs_root: Path) -> None:
    for arguments, said in [
        (["stage=balance,mouunt"], "there is no stage mouunt"),
        (["stage=balance", "logger.experiment=a,b"], "logger.experiment=a,b: all jobs of a multirun share"),
        (["stage=balance", "hydra.sweep.dir=x"], "hydra.sweep.dir=x: the folder of a multirun is chosen by"),
        (["stage=balance", "seed=1,"], "seed=1,: Hydra cannot read this"),
        (["stage=balance", "hydra.launcher.n_jobs=2"], "n_jobs"),
    ]:
        status, out, err = command(scores, "-m", *arguments)
        assert status == 2 and said in err and err.count("\n") == 1, err
        assert list(runs_root.glob("*/*")) == []


def test_the_working_directory_stays(command: Callable[..., Any], runs_root: Path) -> None:
    def where(config: Any, overrides: list[str], job: Job | None = None) -> float:
        assert Path.cwd() == runs_root.parent
        return Score.of(1, 2)

    change = ["stage=balance", "hydra.job.chdir=true"]
    assert command(where, *change, "hydra.run.dir=elsewhere")[0] == 0
    status, out, err = command(where, "-m", *change, "seed=1,2")
    assert status == 0 and out.count("  50.0%  ") == 3, err
    assert Path.cwd() == runs_root.parent


def test_jobs_in_processes_of_their_own(command: Callable[..., Any], runs_root: Path, fresh_workers: None) -> None:
    here = os.getpid()

    def elsewhere(config: Any, overrides: list[str], job: Any) -> float:
        if config.seed == 1:
            raise ValueError("one")
        return type(job.sweep).__module__ == "skatemount.runs.sweep" and float(os.getpid() != here)

    arguments = ["-m", "stage=balance", "seed=1,2,3", "hydra/launcher=joblib", "hydra.launcher.n_jobs=2"]
    status, out, err = command(elsewhere, *arguments)
    assert status == 1 and "job 2 of 3: seed=2\n" in out, err
    assert err.endswith("skatemount.train: job 1 of 3: seed=1: failed: ValueError: one\n")
    (sweep,) = sweeps(runs_root)
    assert [json.loads(file.read_text())["status"] for file in sorted((sweep / "jobs").iterdir())] == [
        "failed", "finished", "finished",
    ]  # fmt: skip
    # The launcher does not matter for what has finished.
    _, out, _ = command(scores, *arguments[:3])
    assert out.count("works on") == 1 and out.count("before, skipped") == 2


def test_a_sweeper_gets_the_score(
    command: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, runs_root: Path
) -> None:
    from hydra._internal.core_plugins.basic_launcher import BasicLauncher

    seen: list[Any] = []
    launch = BasicLauncher.launch

    def watched(self: BasicLauncher, *arguments: Any, **named: Any) -> Any:
        returned = launch(self, *arguments, **named)
        seen.extend(each.return_value for each in returned)
        return returned

    monkeypatch.setattr(BasicLauncher, "launch", watched)
    for _ in range(2):  # what is skipped has the same score
        command(scores, "-m", "stage=balance", "seed=3,7")
    assert seen == [0.3, 0.0, 0.3, 0.0] and all(type(score) is float for score in seen)


def test_programs_other_than_train_run_again_and_write_a_file_each(
    command: Callable[..., Any], runs_root: Path
) -> None:
    def evaluate(config: Any, overrides: list[str]) -> float:
        Path(config.json).write_text(config.suite.name)
        return Score.of(1, 2)

    for _ in range(2):
        status, out, err = command(evaluate, "-m", "suite=far,rolling", "json=r.json", program="evaluate")
        assert status == 0, err
    for suite in ("far", "rolling"):
        assert (runs_root.parent / f"r_suite={suite}.json").read_text() == suite
    assert "50.0%" in out
    assert len(list((runs_root / "multirun").glob("*_evaluate*/multirun.yaml"))) == 2


def test_latest_means_the_same_policy_in_all_jobs(command: Callable[..., Any], runs_root: Path) -> None:
    def checkpoint(name: str) -> Path:
        folder = RunFolder.create(runs_root, "exp", name, {}, []).checkpoint(10)
        save_policy(folder / POLICY_FILE, {"actor": torch.nn.Linear(1, 1)}, PolicyCard(stage="s", config={}))
        return folder

    before = checkpoint("before").relative_to(runs_root.parent)
    seen: list[Any] = []

    def verb(config: Any, overrides: list[str], job: Job) -> float:
        config = _of_job(config, job)[0]
        seen.append((config.init_from, config.algorithm.teacher))
        checkpoint("a_newer_one")
        if config.seed == 2 and len(seen) == 2:
            raise ValueError
        return Score.of(1, 2)

    for _ in range(2):
        command(verb, "-m", "stage=balance", "init_from=latest,null", "algorithm.teacher=latest", "seed=2")
    assert seen == [(str(before), str(before)), (None, str(before)), (None, str(before))]
    (sweep,) = (p for p in sweeps(runs_root))
    assert json.loads((sweep / "sweep.json").read_text())["pinned"] == {"latest": str(before)}
    status, _, err = command(verb, "-m", "stage=balance", "init_from=latest,null", "logger.root=none")
    assert status == 2 and "init_from=latest: no run in none has a checkpoint; there are: pretrained:anywhere" in err
    status, _, err = command(verb, "-m", "stage=balance", "algorithm.teacher=latest,null", "logger.root=none")
    assert status == 2 and "algorithm.teacher=latest: no run in none has a checkpoint" in err
    assert list(Path("none").glob("*/*")) == []


def test_files_are_separate_unless_the_user_separates_them(tmp_path: Path) -> None:
    class Config:
        json = "a/r.json"
        output = "results"

    config, sweep = Config(), SweepFolder(tmp_path, "evaluate")
    separate_files(config, Job(sweep, 1, [], {"output": "x", "suite": "far"}))
    assert (config.json, config.output) == ("a/r_output=x,suite=far.json", "results")
    separate_files(config, Job(sweep, 1, [], {}))
    assert config.json == "a/r_output=x,suite=far.json"


def test_a_multirun_is_asked_for_in_three_ways() -> None:
    assert multirun.is_asked_for(["-m"]) and multirun.is_asked_for(["--multirun", "a=1"])
    assert multirun.is_asked_for(["hydra.mode=MULTIRUN"]) and not multirun.is_asked_for(["stage=balance"])


def test_trainings_resume_in_a_sweep(
    command: Callable[..., Any], runs_root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tiny = [each for each in TINY if not each.startswith("logger.final")] + ["logger.final_episodes=2"]
    arguments = ["-m", "stage=balance", "seed=1,2", *tiny, f"total_frames={2 * BATCH}"]
    save = CheckpointCallback.on_iteration_end

    def interrupt(self: CheckpointCallback, trainer: Trainer, metrics: dict[str, float]) -> None:
        save(self, trainer, metrics)
        raise KeyboardInterrupt

    def first_finishes(config: Any, overrides: list[str], job: Job) -> float:
        return scores(config, overrides) if job.number == 1 else train(config, overrides, job)

    with monkeypatch.context() as patched:
        patched.setattr(CheckpointCallback, "on_iteration_end", interrupt)
        status, out, err = command(first_finishes, *arguments)
    assert status == 130 and err.endswith(
        "; start the same command again: it skips the jobs that have finished, and resumes one that was cut off\n"
    )
    assert "\nskatemount.train: ended by SIGINT; the sweep is kept in runs/skatemount/" in err
    (sweep,) = sweeps(runs_root)
    cut_off = RunFolder(sweep / "seed=2").latest
    assert cut_off is not None and cut_off.name == f"step_{BATCH:012d}"

    status, out, err = command(train, *arguments)
    assert status == 0, err
    assert "job 1 of 2: seed=1: has finished before, skipped" in out
    assert f"resumes runs/skatemount/{sweep.name}/seed=2\n" in out
    assert sorted(p.name for p in sweep.iterdir() if p.is_dir()) == ["jobs", "seed=2"]
    record = json.loads((sweep / "jobs" / "seed=2.json").read_text())
    assert (record["steps"], record["episodes"], record["run"]) == (2 * BATCH, 2, "seed=2")

    # The run can be named, and is the latest.
    assert find_checkpoint("latest", runs_root).parents[1].name == "seed=2"
    assert find_checkpoint(f"skatemount/{sweep.name}/seed=2", runs_root).parents[1] == sweep / "seed=2"
    with pytest.raises(ConfigError, match=f"a sweep; name one of its runs: {sweep}/seed=2$"):
        find_checkpoint(str(sweep), runs_root)

    # Only its final evaluation was cut off.
    (sweep / "jobs" / "seed=2.json").unlink()
    (sweep / "seed=2" / "evaluation.json").unlink()
    status, out, err = command(train, *arguments)
    assert status == 0 and out.count("episodes        2") == 1, err
    assert json.loads((sweep / "jobs" / "seed=2.json").read_text()) == record


@pytest.mark.parametrize(
    ("error", "said", "run"),
    [
        (OSError(28, "No space left on device", "somewhere"), "somewhere: No space left on device", "run"),
        (FloatingPointError("loss is nan"), "loss is nan", "run_2"),
    ],
)
def test_what_failed_is_repeated_and_goes_on_after_a_full_disk(
    error: Exception,
    said: str,
    run: str,
    command: Callable[..., Any],
    runs_root: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    arguments = ["-m", "stage=balance", "seed=1", *TINY, f"total_frames={2 * BATCH}"]

    def fail(self: CheckpointCallback, trainer: Trainer, metrics: dict[str, float]) -> None:
        trainer.save(metrics)
        raise error

    with monkeypatch.context() as patched:
        patched.setattr(CheckpointCallback, "on_iteration_end", fail)
        status, _, err = command(train, *arguments)
    assert status == 1 and f": failed: {said}" in err.splitlines()[-1] and "Traceback" not in err
    status, out, _ = command(train, *arguments)
    (sweep,) = sweeps(runs_root)
    assert status == 0 and f"repeated, it failed before: {said}" in out
    assert (f"resumes runs/skatemount/{sweep.name}/run\n" in out) == (run == "run")
    record = json.loads((sweep / "jobs" / "run.json").read_text())
    assert (record["status"], record["run"], record["success"]) == ("finished", run, None)
    assert record["steps"] == 2 * BATCH


@pytest.mark.slow
@pytest.mark.parametrize("launcher", ["basic", "joblib"])
def test_a_killed_multirun_resumes_in_processes(launcher: str, runs_root: Path) -> None:
    tiny = [each for each in TINY if not each.startswith("logger.final")]
    arguments = [
        "-m", "stage=balance", "init_from=null,pretrained:anywhere", "seed=1,2", *tiny, "total_frames=320",
        "logger.final_episodes=4", "logger.checkpoint_every=5", f"hydra/launcher={launcher}",
        "callbacks=[holding:Holds]",
        *(["hydra.launcher.n_jobs=2"] if launcher == "joblib" else []),
    ]  # fmt: skip

    hold = runs_root.parent / HOLD
    hold.touch()
    process = start("train", runs_root, *arguments)
    try:
        wait_for(process, runs_root, "*/*/init_from=null,seed=1/checkpoints/step_*")
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
    (sweep,) = sweeps(runs_root)
    assert not (sweep / "results.json").exists()

    hold.unlink()
    process = start("train", runs_root, *arguments)
    out, err = process.communicate()
    assert process.returncode == 1, err
    assert f"resumes runs/skatemount/{sweep.name}/init_from=null,seed=1\n" in out
    assert sweeps(runs_root) == [sweep]
    jobs = json.loads((sweep / "results.json").read_text())["jobs"]
    assert [(job["status"], job["steps"], job["run"]) for job in jobs] == [
        ("finished", 320, "init_from=null,seed=1"),
        ("finished", 320, "init_from=null,seed=2"),
        ("failed", None, None),
        ("failed", None, None),
    ]
    assert err.count("seed=1: failed: init_from=pretrained:anywhere: ") == 2
    assert "\x1b" not in out + err
