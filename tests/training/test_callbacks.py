"""Callbacks: when they run, what they may do, and what a checkpoint keeps of them."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import pytest
from tiny import BATCH, SILENT, TINY

from skatemount.config import compose
from skatemount.runs.checkpoint import load_training_state
from skatemount.runs.folder import RunFolder
from skatemount.runs.metrics import read_metrics
from skatemount.training import callbacks as module
from skatemount.training.callbacks import (
    Callback,
    EvaluationCallback,
    LoggerCallback,
    arrange_callbacks,
    make_callbacks,
)
from skatemount.training.resume import resume_config
from skatemount.training.trainer import Trainer
from skatemount.utils.errors import ConfigError
from skatemount.utils.signals import Ended

pytestmark = pytest.mark.usefixtures("no_pictures")

EVALUATED = ["logger.evaluate_every=2", "logger.evaluate_episodes=4", "logger.tensorboard=false"]


class Recorder(Callback):
    """Notes its calls, adds a metric, and counts iterations in a state of its own."""

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.total = 0

    def on_train_start(self, trainer: Trainer) -> None:
        self.calls.append("start")

    def on_batch_collected(self, trainer: Trainer, batch: Any) -> None:
        assert batch.shape == (8, 4)
        self.calls.append("batch")

    def on_iteration_end(self, trainer: Trainer, metrics: dict[str, float]) -> None:
        assert "Loss/kl" in metrics
        self.calls.append("evaluated" if "Evaluation/success" in metrics else "iteration")
        self.total += 1
        metrics["Mine/total"] = float(self.total)

    def on_evaluation_end(self, trainer: Trainer, evaluation: Any) -> None:
        self.calls.append(f"{evaluation.episodes} episodes")

    def on_train_end(self, trainer: Trainer) -> None:
        self.calls.append("end")

    def state_dict(self) -> dict[str, Any]:
        return {"total": self.total}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.total = state["total"]


def trainer_with(root: Path, *callbacks: Callback, overrides: list[str], frames: int = 3 * BATCH) -> Trainer:
    given = [*TINY, f"total_frames={frames}", f"logger.root={root}", *overrides]
    return Trainer(compose("balance", given), given, callbacks=callbacks)


def train(trainer: Trainer) -> Trainer:
    try:
        trainer.train()
    finally:
        trainer.close()
    return trainer


def test_the_hooks_run_in_order_and_their_metrics_are_logged(tmp_path: Path) -> None:
    recorder = Recorder()
    trainer = train(trainer_with(tmp_path, recorder, overrides=EVALUATED))
    assert recorder.calls == [
        "start", "batch", "iteration", "batch", "4 episodes", "evaluated", "batch", "4 episodes", "evaluated", "end",
    ]  # fmt: skip
    assert read_metrics(trainer.run.metrics_file)["Mine/total"].tolist() == [1, 2, 3]


def test_a_checkpoint_keeps_the_state_of_callbacks(tmp_path: Path) -> None:
    begun = train(trainer_with(tmp_path, Recorder(), overrides=SILENT))
    assert begun.run.latest is not None
    assert load_training_state(begun.run.latest)["callbacks"] == {"Recorder": {"total": 3}}
    given = [f"resume={begun.run.path}", f"total_frames={4 * BATCH}"]
    recorder, other = Recorder(), Recorder()
    trainer = Trainer(resume_config(compose(None, given), given), given, callbacks=[recorder, other])
    assert (recorder.total, other.total) == (3, 0)
    train(trainer)
    assert trainer.run.latest is not None
    states = load_training_state(trainer.run.latest)["callbacks"]
    assert states == {"Recorder": {"total": 4}, "Recorder#2": {"total": 1}}
    # Without the callbacks, the run resumes as well.
    given = [f"resume={begun.run.path}", f"total_frames={5 * BATCH}"]
    assert train(Trainer(resume_config(compose(None, given), given), given)).iteration == 5


def test_a_callback_may_end_the_training(tmp_path: Path) -> None:
    class Stop(Callback):
        def on_iteration_end(self, trainer: Trainer, metrics: dict[str, float]) -> None:
            if trainer.iteration == 2:
                trainer.stop()

    trainer = train(trainer_with(tmp_path, Stop(), overrides=SILENT, frames=100 * BATCH))
    assert trainer.run.latest is not None and trainer.run.latest.name == f"step_{2 * BATCH:012d}"


def test_an_error_still_ends_and_closes_everything(tmp_path: Path) -> None:
    class Fails(Callback):
        def on_iteration_end(self, trainer: Trainer, metrics: dict[str, float]) -> None:
            raise RuntimeError("as it must")

    class Kept:
        closed = False

        def log(self, metrics: dict[str, float], frames: int) -> None:
            raise AssertionError("the callback before has failed")

        def close(self) -> None:
            self.closed = True

    recorder, kept = Recorder(), Kept()
    trainer = trainer_with(tmp_path, recorder, Fails(), LoggerCallback([kept]), overrides=SILENT)
    with pytest.raises(RuntimeError, match="as it must"):
        train(trainer)
    assert recorder.calls[-1] == "end" and kept.closed
    assert trainer.run.latest is not None  # what was trained is kept
    with trainer.run.lock():
        pass  # it has been released


def test_a_users_logger_gets_floats_beside_the_default_ones(tmp_path: Path) -> None:
    logged: list[tuple[int, dict[str, float]]] = []

    class Memory:
        def log(self, metrics: dict[str, float], frames: int) -> None:
            logged.append((frames, metrics))

        def close(self) -> None:
            logged.append((-1, {}))

    trainer = train(trainer_with(tmp_path, LoggerCallback([Memory()]), overrides=["logger.tensorboard=false"]))
    assert [frames for frames, _ in logged] == [BATCH, 2 * BATCH, 3 * BATCH, -1]
    assert all(type(value) is float for _, metrics in logged for value in metrics.values())
    assert len(read_metrics(trainer.run.metrics_file)["frames"]) == 3


def test_a_subclass_of_a_default_callback_takes_its_place() -> None:
    class Mine(EvaluationCallback):
        pass

    def names(*callbacks: Callback) -> list[str]:
        return [type(each).__name__ for each in arrange_callbacks(callbacks)]

    defaults = [f"{name}Callback" for name in ("Curriculum", "Evaluation", "Logger", "Checkpoint", "Plot")]
    assert names() == defaults
    assert names(Recorder(), Mine()) == [defaults[0], "Mine", "Recorder", *defaults[2:]]
    assert all(issubclass(getattr(module, name), Callback) for name in defaults)


class Refuses(Callback):
    """Ends a training at a given hook with a given error."""

    def __init__(self, hook: str, error: BaseException) -> None:
        setattr(self, hook, self.refuse)
        self.error = error

    def refuse(self, *arguments: Any) -> None:
        raise self.error


@pytest.mark.parametrize("hook", ["on_train_start", "on_batch_collected"])
@pytest.mark.parametrize("error", [ConfigError("no"), RuntimeError("no"), Ended(signal.SIGINT)], ids=repr)
def test_a_training_that_fails_before_anything_is_trained_leaves_no_folder(
    hook: str, error: BaseException, tmp_path: Path
) -> None:
    root = tmp_path / "runs"
    with pytest.raises(type(error)) as raised:
        train(trainer_with(root, Refuses(hook, error), overrides=[]))
    assert list(root.iterdir()) == []
    assert not isinstance(error, Ended) or str(raised.value) == "ended by SIGINT; nothing was trained"


def test_a_training_that_fails_later_keeps_its_folder(tmp_path: Path) -> None:
    class Late(Callback):
        def on_iteration_end(self, trainer: Trainer, metrics: dict[str, float]) -> None:
            if trainer.iteration == 2:
                raise RuntimeError("late")

    with pytest.raises(RuntimeError):
        train(trainer_with(tmp_path, Late(), overrides=["logger.checkpoint_every=1"]))
    (run,) = tmp_path.glob("*/*")
    assert RunFolder(run).latest is not None


class Odd(Callback):
    """Needs what nobody gives."""

    def __init__(self) -> None:
        {}["nothing"]

    def on_train_start(self, trainer: Trainer) -> None: ...


def test_a_callback_that_cannot_be_made_is_named() -> None:
    with pytest.raises(ConfigError) as error:
        make_callbacks([f"{__name__}:Odd"])
    where = f"callbacks={__name__}:Odd: Odd of {__name__} cannot be made: "
    assert str(error.value).startswith(f"{where}KeyError: 'nothing' ({__file__}, line ")
    with pytest.raises(ConfigError, match=r"Needy of .* cannot be made: TypeError: .* missing 1 required"):
        make_callbacks([f"{__name__}:Needy"])


class Needy(Odd):
    """Needs an argument."""

    def __init__(self, given: int) -> None: ...
