"""`python -m skatemount.search`: trials of one process or several, stopped and gone on."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from holding import HOLD
from started import start, wait_for
from tiny import BATCH, TINY

import skatemount.train as training
from skatemount.config import compose_program, set_user_config_dir
from skatemount.runs.folder import RunFolder
from skatemount.runs.sweep import Score
from skatemount.search import search
from skatemount.searching import study as study_module
from skatemount.training.callbacks import CheckpointCallback
from skatemount.training.trainer import Trainer

pytestmark = pytest.mark.usefixtures("no_pictures")

SPACE = "search.space.algorithm.target_kl=log(0.001,0.1)"
ARGUMENTS = ["stage=balance", "search.trials=4", SPACE]


@pytest.fixture
def command(call_program: Callable[..., Any]) -> Iterator[Callable[..., Any]]:
    """Calls the program with arguments; returns status, output and error output."""
    pytest.importorskip("optuna")
    yield lambda *arguments: call_program(search, "search", *arguments)
    set_user_config_dir(None)


class Stand:
    """Stands for a training: its success falls with the step size.

    Args:
        ends: What the trials of these numbers raise.
    """

    def __init__(self, ends: dict[int, BaseException] | None = None) -> None:
        self.ends = ends or {}
        self.trained: list[tuple[int, float]] = []

    def __call__(self, config: Any, overrides: list[str], job: Any, callbacks: Any = ()) -> Score:
        if (error := self.ends.get(job.number)) is not None:
            raise error
        assert len(callbacks) == 1 and config.stage.name == "balance"
        self.trained.append((job.number, config.algorithm.target_kl))
        return Score.of(round(100 * (1 - 5 * config.algorithm.target_kl)), 100, 64, job.sweep.path / job.label)


def documents(runs_root: Path) -> list[dict[str, Any]]:
    return [json.loads(file.read_text()) for file in sorted(runs_root.glob("*/*/results.json"))]


def test_a_stopped_search_goes_on_and_failed_trials_do_not_end_it(
    command: Callable[..., Any], runs_root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = Stand({2: FloatingPointError("loss is nan"), 3: KeyboardInterrupt()}), Stand()
    monkeypatch.setattr(training, "train", first)
    status, out, err = command(*ARGUMENTS)
    assert status == 130
    assert err.splitlines()[-1].endswith("; start the same command again to go on") and "ended by SIGINT" in err
    assert "trial 2 of 4: algorithm.target_kl=" in err and "failed: " in err and "Traceback" not in err
    (folder,) = runs_root.glob("*/search_*")
    assert out.startswith(f"search: runs/skatemount/{folder.name}\n")

    monkeypatch.setattr(training, "train", second)
    status, out, err = command(*ARGUMENTS[::-1], "torch_threads=1")
    assert status == 0, err
    assert "; goes on, logger.experiment=<another> starts afresh\n" in out and "; taken over\n" in out
    assert [number for number, _ in first.trained] == [1] and [number for number, _ in second.trained] == [3, 4]
    (document,) = documents(runs_root)
    assert [each["status"] for each in document["trials"]] == ["finished", "failed", "finished", "finished"]
    assert document["trials"][1]["error"] == "loss is nan"
    tried = dict([*first.trained, *second.trained])
    assert all(each["settings"]["algorithm.target_kl"] == tried[each["number"]] for each in document["trials"][2:])
    best = min(tried, key=lambda number: tried[number])
    assert document["best"]["number"] == best and f"best: trial {best}, " in out
    set_user_config_dir(folder / "best")
    assert compose_program("train", ["experiment=best"]).algorithm.target_kl == tried[best]  # type: ignore[attr-defined]
    set_user_config_dir(None)

    # Nothing is left to do; a larger number goes on.
    status, out, _ = command(*ARGUMENTS)
    assert status == 0 and "trial 1 of 4" not in out and " finished\n" in out
    status, out, _ = command(*ARGUMENTS, "search.trials=5")
    assert [number for number, _ in second.trained] == [3, 4, 5] and len(documents(runs_root)) == 1


def test_a_full_disk_ends_the_search_and_the_trial_goes_on(
    command: Callable[..., Any], runs_root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(training, "train", Stand({1: OSError(28, "No space left on device", "somewhere")}))
    status, _, err = command(*ARGUMENTS)
    assert (status, err.count("\n")) == (2, 1) and "somewhere: No space left on device" in err
    stand = Stand()
    monkeypatch.setattr(training, "train", stand)
    command(*ARGUMENTS)
    assert [number for number, _ in stand.trained] == [1, 2, 3, 4]


def test_no_success_is_status_one(command: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training, "train", Stand(dict.fromkeys(range(9), ZeroDivisionError("own code"))))
    status, out, err = command(*ARGUMENTS[:1], "search.trials=2", SPACE)
    assert status == 1 and out.endswith("no trial has succeeded\n")
    assert err.count("Traceback") == 2 and "failed: ZeroDivisionError: own code" in err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["stage=balance"], "search.space={} must have a range"),
        (["stage=balance", SPACE, "-m", "seed=0,1"], "-m: a search chooses the settings of its trials itself"),
        (["stage=balance", SPACE, "resume=latest"], "resume=latest: a search goes on by the same command"),
        ([SPACE], "no stage: give stage=<name>"),
        (["stage=balance", SPACE, "search=nope"], "there is no search nope"),
        (["curriculum=paper", SPACE], "search.pruner=median with curriculum=paper: success in different stages"),
        (
            ["stage=balance", SPACE, "logger.final_episodes=0", "logger.evaluate_every=0"],
            "logger.final_episodes=0 with logger.evaluate_every=0: a trial needs an evaluation",
        ),
        (["stage=balance", "search.space.algorithm.lr=log(1,2)"], "there is no setting algorithm.lr"),
        (["stage=balance", SPACE.replace("space", "sace")], "did you mean search.space.algorithm.target_kl?"),
        (
            ["stage=balance", SPACE, "launcher=joblib"],
            "launcher=joblib: a search has no launcher; start the command once more for another process",
        ),
    ],
)
def test_wrong_commands_are_one_line(
    arguments: list[str], said: str, command: Callable[..., Any], runs_root: Path
) -> None:
    status, out, err = command(*arguments)
    assert status == 2 and said in err and err.count("\n") == 1, err
    assert list(runs_root.glob("*/*")) == []


def test_torchrun_and_a_missing_package_are_one_line(
    command: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patched:
        for name, value in {"RANK": "0", "WORLD_SIZE": "2", "MASTER_ADDR": "127.0.0.1"}.items():
            patched.setenv(name, value)
        status, _, err = command(*ARGUMENTS)
    assert status == 2 and "cannot be started by torchrun" in err and err.count("\n") == 1
    monkeypatch.setattr(study_module.importlib.util, "find_spec", lambda name: None)
    status, _, err = command(*ARGUMENTS)
    assert (status, err) == (
        2, "skatemount.search: skatemount.search needs the package optuna: pip install 'skatemount[sweep]'\n",
    )  # fmt: skip


def test_a_trial_resumes_from_its_checkpoint(
    command: Callable[..., Any], runs_root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tiny = [each for each in TINY if not each.startswith("logger.final")] + ["logger.final_episodes=2"]
    arguments = ["stage=balance", "search.trials=1", SPACE, *tiny, "init_from=null", f"total_frames={2 * BATCH}"]
    save = CheckpointCallback.on_iteration_end

    def interrupt(self: CheckpointCallback, trainer: Trainer, metrics: dict[str, float]) -> None:
        save(self, trainer, metrics)
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(CheckpointCallback, "on_iteration_end", interrupt)
        assert command(*arguments)[0] == 130
    (run,) = runs_root.glob("*/search_*/trial_001")
    cut_off = RunFolder(run).latest
    assert cut_off is not None and cut_off.name == f"step_{BATCH:012d}"
    status, out, err = command(*arguments)
    assert status == 0, err
    assert f"resumes runs/skatemount/{run.parent.name}/trial_001\n" in out
    (document,) = documents(runs_root)
    assert [(each["steps"], each["episodes"], each["run"]) for each in document["trials"]] == [
        (2 * BATCH, 2, "trial_001")
    ]


@pytest.mark.slow
def test_two_processes_share_a_search_and_take_over_a_killed_one(runs_root: Path) -> None:
    pytest.importorskip("optuna")
    tiny = [each for each in TINY if not each.startswith("logger.final")]
    arguments = [
        "stage=balance", "init_from=null", SPACE, *tiny, "search.trials=4", "total_frames=640",
        "logger.final_episodes=4", "logger.checkpoint_every=5", "callbacks=[holding:Holds]",
    ]  # fmt: skip

    hold = runs_root.parent / HOLD
    hold.touch()
    killed = start("search", runs_root, *arguments)
    try:
        wait_for(killed, runs_root, "*/*/trial_001/checkpoints/step_*")
    finally:
        os.killpg(killed.pid, signal.SIGKILL)
        killed.communicate()
    hold.unlink()
    processes = [start("search", runs_root, *arguments) for _ in range(2)]
    ended = [(process.communicate(), process.returncode) for process in processes]
    assert [status for _, status in ended] == [0, 0], ended
    printed = [out for (out, _), _ in ended]
    assert sum(out.count("; taken over\n") for out in printed) == 1
    assert sum("resumes runs/skatemount/" in out for out in printed) == 1
    begun = sorted(line.split(":")[0] for out in printed for line in out.splitlines() if line.startswith("trial "))
    assert begun == [f"trial {number} of 4" for number in (1, 2, 3, 4)]
    (folder,) = runs_root.glob("*/search_*")
    trials = json.loads((folder / "results.json").read_text())["trials"]
    assert [each["status"] for each in trials] == ["finished"] * 4
    assert len({each["settings"]["algorithm.target_kl"] for each in trials}) == 4
    assert sorted(path.name for path in folder.glob("trial_*")) == [f"trial_00{number}" for number in (1, 2, 3, 4)]
