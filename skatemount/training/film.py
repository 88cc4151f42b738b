"""`FilmCallback`: films of the policy during a training."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import TYPE_CHECKING

from skatemount import config as configuration
from skatemount.rendering.opengl import VARIABLE
from skatemount.training.callbacks import Callback
from skatemount.training.commands import policy_settings
from skatemount.utils.decoration import Decoration

if TYPE_CHECKING:
    from skatemount.evaluation.results import Evaluation
    from skatemount.training.trainer import Trainer

LONGEST = 600.0
"""Seconds that the end of a training waits for a film."""


class FilmCallback(Callback):
    """Films the policy after each evaluation, into the run's folder ``videos``; ``callbacks=[film]`` adds it.

    `python -m skatemount.record` does so beside the training, on one core. An evaluation that ends while a film is
    drawn gets none, except the last one. A film that fails is a warning.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None
        # Environment steps of the evaluation whose checkpoint gets the next film.
        self._due: int | None = None
        self._decoration = Decoration("the film of the policy")

    def on_evaluation_end(self, trainer: Trainer, evaluation: Evaluation) -> None:
        """Note that a film is due."""
        self._due = trainer.frames

    def on_iteration_end(self, trainer: Trainer, metrics: dict[str, float]) -> None:
        """Begin a film once its checkpoint is saved, unless another one is being drawn."""
        with self._decoration:
            if self._process is not None and self._process.poll() is not None:
                self._finish()
            if self._process is None:
                self._begin(trainer)

    def on_interrupt(self, trainer: Trainer) -> None:
        """Give up the film that is being drawn."""
        self._due = None
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None

    def on_train_end(self, trainer: Trainer) -> None:
        """Wait for the film that is being drawn, and film the last checkpoint."""
        for _ in range(2):
            with self._decoration:
                if self._process is not None:
                    self._finish()
                self._begin(trainer)

    def _begin(self, trainer: Trainer) -> None:
        if self._due is None or trainer.saved_frames < self._due:
            return
        self._due = None
        checkpoint, root = trainer.run.checkpoint(trainer.saved_frames), trainer.config.logger.root
        settings = [f"checkpoint={checkpoint}", *policy_settings(trainer.run)[1:], f"output={trainer.run.videos}"]
        threads = ["torch_threads=1", "physics.threads=1", f"logger.root={root}"]
        # A training draws nothing, so its choice of an OpenGL library is none.
        environment = {name: value for name, value in os.environ.items() if name != VARIABLE}
        self._process = subprocess.Popen(
            [sys.executable, "-m", "skatemount.record", *configuration.config_dir_options(), *settings, *threads],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            env=environment,
        )

    def _finish(self) -> None:
        """Wait for the film.

        Raises:
            RuntimeError: It failed; the message is the last line of the program.
            subprocess.TimeoutExpired: It took more than `LONGEST`.
        """
        assert self._process is not None
        process, self._process = self._process, None
        try:
            errors = process.communicate(timeout=LONGEST)[1]
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            raise
        if process.returncode:
            lines = errors.strip().splitlines()
            raise RuntimeError(lines[-1] if lines else f"status {process.returncode}")
