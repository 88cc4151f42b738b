"""Films of the policy during a training."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from tiny import BATCH, TINY

from skatemount.config import compose
from skatemount.runs.folder import RunFolder
from skatemount.training import film as module
from skatemount.training.callbacks import make_callbacks
from skatemount.training.film import FilmCallback
from skatemount.training.trainer import Trainer

needs_opengl = pytest.mark.skipif(
    os.environ.get("MUJOCO_GL") not in ("egl", "osmesa"), reason="needs OpenGL without a display"
)


class Process:
    """A program that draws until the test says that it has ended."""

    started: list[Process] = []
    status = 0

    def __init__(self, command: list[str], **options: Any) -> None:
        self.command, self.environment, self.ended, self.killed = command, options["env"], False, False
        self.returncode = Process.status
        Process.started.append(self)

    def poll(self) -> int | None:
        return self.returncode if self.ended else None

    def communicate(self, timeout: float | None = None) -> tuple[str, str]:
        return "", "drawing\nskatemount.record: cannot draw\n"

    def kill(self) -> None:
        self.killed = True


@pytest.fixture
def trainer(runs_root: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setenv("MUJOCO_GL", "disable")
    monkeypatch.setattr(Process, "started", [])
    run = RunFolder.create(runs_root, "exp", "balance", {"network": {"kind": "mlp"}}, [])
    monkeypatch.setattr(module.subprocess, "Popen", Process)
    logger = SimpleNamespace(root=str(runs_root))
    return SimpleNamespace(run=run, frames=0, saved_frames=0, config=SimpleNamespace(logger=logger))


def iterate(callback: FilmCallback, trainer: Any, evaluated: bool = False) -> None:
    """An iteration: the evaluation, the callback, the checkpoint."""
    trainer.frames += 10
    if evaluated:
        callback.on_evaluation_end(trainer, None)  # type: ignore[arg-type]
    callback.on_iteration_end(trainer, {})
    if evaluated:
        trainer.saved_frames = trainer.frames


def test_a_film_begins_when_the_checkpoint_of_an_evaluation_is_saved(trainer: Any) -> None:
    (callback,) = make_callbacks(["film"])
    assert isinstance(callback, FilmCallback)
    iterate(callback, trainer, evaluated=True)
    assert Process.started == []
    iterate(callback, trainer)
    (process,) = Process.started
    assert f"checkpoint={trainer.run.checkpoint(10)}" in process.command
    assert f"output={trainer.run.videos}" in process.command and "MUJOCO_GL" not in process.environment
    # One at a time: this evaluation waits, and the next one takes its place.
    iterate(callback, trainer, evaluated=True)
    iterate(callback, trainer, evaluated=True)
    assert len(Process.started) == 1
    process.ended = True
    iterate(callback, trainer)
    assert [p.command[3].rpartition("_")[2] for p in Process.started] == ["000000000010", "000000000040"]


def test_the_end_waits_for_films_and_films_the_last_checkpoint(trainer: Any) -> None:
    callback = FilmCallback()
    iterate(callback, trainer, evaluated=True)
    iterate(callback, trainer)
    iterate(callback, trainer, evaluated=True)
    callback.on_train_end(trainer)
    assert len(Process.started) == 2 and callback._process is None


def test_an_interrupted_training_gives_the_film_up(trainer: Any) -> None:
    callback = FilmCallback()
    iterate(callback, trainer, evaluated=True)
    iterate(callback, trainer)
    callback.on_interrupt(trainer)
    callback.on_train_end(trainer)
    assert [process.killed for process in Process.started] == [True]


def test_a_film_that_fails_is_one_warning(
    trainer: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(Process, "status", 2)
    callback = FilmCallback()
    for _ in range(2):
        iterate(callback, trainer, evaluated=True)
        iterate(callback, trainer)
        Process.started[-1].ended = True
    callback.on_train_end(trainer)
    warned = "warning: the film of the policy failed, the rest goes on (RuntimeError: skatemount.record: cannot draw)\n"
    assert capsys.readouterr().err == warned and len(Process.started) == 2


@pytest.mark.slow
@needs_opengl
def test_a_training_leaves_a_film_of_its_last_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    given = [*TINY, f"total_frames={2 * BATCH}", "callbacks=[film]", "logger.root=runs", "logger.evaluate_every=2",
             "logger.evaluate_episodes=4", "logger.tensorboard=false", "logger.plot_every=1000"]  # fmt: skip
    trainer = Trainer(compose("balance", given), given)
    trainer.train()
    trainer.close()
    assert capsys.readouterr().err == ""
    (film,) = trainer.run.videos.glob("*.mp4")
    assert trainer.run.checkpoint(2 * BATCH).name in film.name
    assert film.stat().st_size > 1000
