"""Callbacks: what happens around learning, at fixed moments of a training."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING, Any

from tensordict import TensorDictBase

from skatemount.config.registries import CALLBACKS, HOOKS
from skatemount.runs.loggers import Logger, as_numbers, open_loggers
from skatemount.runs.metrics import MetricsFile
from skatemount.training.divergence import DivergedFiles
from skatemount.training.plots import plot_learning_curves
from skatemount.utils.classes import made
from skatemount.utils.decoration import Decoration
from skatemount.utils.errors import ConfigError
from skatemount.utils.formatting import format_count

if TYPE_CHECKING:
    from skatemount.evaluation.results import Evaluation
    from skatemount.training.trainer import Trainer


class Callback:
    """Base class of callbacks: every method does nothing, and subclasses override those that they need.

    A callback may read everything of the trainer, change a batch or the metrics in place, and end the training with
    ``trainer.stop()``.

    Attributes:
        on_all_ranks: Run on every rank of a training with several. The default is on rank 0 only, which is right for
            what is written and shown. A callback that changes batches, or what is trained, must run on every rank.
    """

    on_all_ranks: bool = False

    def on_train_start(self, trainer: Trainer) -> None:
        """Run before the first batch is collected, also when a run resumes."""

    def on_batch_collected(self, trainer: Trainer, batch: TensorDictBase) -> None:
        """Run before a batch ``[N, T]`` is learned from."""

    def on_iteration_end(self, trainer: Trainer, metrics: dict[str, float]) -> None:
        """Run after an update; metrics that are added here are logged if the callback comes before `LoggerCallback`."""

    def on_evaluation_end(self, trainer: Trainer, evaluation: Evaluation) -> None:
        """Run after an evaluation during the training."""

    def on_interrupt(self, trainer: Trainer) -> None:
        """Run when a signal or an error ends the training, before `on_train_end`."""

    def on_train_end(self, trainer: Trainer) -> None:
        """Run when the training has ended, in whatever way; the final evaluation comes later."""

    def state_dict(self) -> dict[str, Any]:
        """Return what a checkpoint has to keep: nested dicts of tensors and plain values, or an empty dict."""
        return {}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` returned."""


class CurriculumCallback(Callback):
    """Lets the curriculum decide, after each batch, where the next episodes start."""

    on_all_ranks = True

    def on_batch_collected(self, trainer: Trainer, batch: TensorDictBase) -> None:
        """Update the curriculum with the episodes that ended in the batch."""
        if trainer.curriculum is not None:
            trainer.curriculum.update()
            trainer.env.set_start_sampler(trainer.curriculum.sample_poses)

    def on_iteration_end(self, trainer: Trainer, metrics: dict[str, float]) -> None:
        """Add ``Curriculum/*``."""
        if trainer.curriculum is not None:
            metrics.update(trainer.curriculum.metrics())


class EvaluationCallback(Callback):
    """Evaluates the policy every ``logger.evaluate_every`` iterations and at the end; ends the training at the gate."""

    def evaluate(self, trainer: Trainer) -> Evaluation:
        """Return an evaluation of ``logger.evaluate_episodes`` episodes with deterministic actions."""
        return trainer.evaluate(trainer.config.logger.evaluate_episodes, trainer.display.show_evaluation)

    def on_iteration_end(self, trainer: Trainer, metrics: dict[str, float]) -> None:
        """Evaluate if it is time; add ``Evaluation/*``."""
        every = trainer.config.logger.evaluate_every
        if not every or (trainer.iteration % every and not trainer.stopping):
            return
        evaluation = self.evaluate(trainer)
        metrics.update(evaluation.metrics())
        for callback in trainer.callbacks:
            callback.on_evaluation_end(trainer, evaluation)
        if gate_reached(trainer.config.stage.gate, metrics):
            trainer.stop()


class LoggerCallback(Callback):
    """Writes the metrics to the loggers that the settings name, and to the display.

    An error of ``metrics.jsonl`` ends the training; that of any other logger is a warning.

    Args:
        loggers: Further loggers. They are closed when the training ends.
    """

    def __init__(self, loggers: Iterable[Logger] = ()) -> None:
        self.loggers: list[Logger] = list(loggers)
        self._decorations: dict[int, Decoration] = {}

    def on_train_start(self, trainer: Trainer) -> None:
        """Open the loggers."""
        settings = trainer.config.logger
        self.loggers += open_loggers(
            trainer.run, settings.jsonl, settings.tensorboard, trainer.frames, settings.loggers
        )
        self.loggers.append(trainer.display)
        if settings.dump_diverged:
            files = DivergedFiles(trainer.run.path / "diverged", trainer.task.scene, settings.dump_diverged)
            trainer.env.divergence.watch(files)

    def on_iteration_end(self, trainer: Trainer, metrics: dict[str, float]) -> None:
        """Log the metrics."""
        values = as_numbers(metrics)
        for logger in self.loggers:
            with self._guarded(logger):
                logger.log(values, trainer.frames)

    def on_train_end(self, trainer: Trainer) -> None:
        """Close the loggers."""
        while self.loggers:
            logger = self.loggers.pop()
            with self._guarded(logger):
                logger.close()

    def _guarded(self, logger: Logger) -> AbstractContextManager[Any]:
        if isinstance(logger, MetricsFile):
            return nullcontext()
        return self._decorations.setdefault(id(logger), Decoration(f"the logger {type(logger).__name__}"))


class CheckpointCallback(Callback):
    """Saves every ``logger.checkpoint_every`` iterations, after each evaluation, at the end and when interrupted."""

    def on_iteration_end(self, trainer: Trainer, metrics: dict[str, float]) -> None:
        """Save a checkpoint if it is time."""
        due = trainer.iteration % trainer.config.logger.checkpoint_every == 0
        if due or "Evaluation/success" in metrics or trainer.stopping:
            trainer.save(metrics)

    def on_interrupt(self, trainer: Trainer) -> None:
        """Save what is not saved yet."""
        # A saved checkpoint may have been evaluated, and half an iteration more does not make it better.
        if trainer.frames != trainer.saved_frames:
            trainer.save({})


class PlotCallback(Callback):
    """Draws the learning curves and the curriculum every ``logger.plot_every`` seconds and at the end."""

    def __init__(self) -> None:
        self._drawn = time.monotonic()
        self._curves = Decoration("the picture of the learning curves")
        self._map = Decoration("the picture of the curriculum")

    def on_train_start(self, trainer: Trainer) -> None:
        """Start the clock."""
        self._drawn = time.monotonic()

    def on_iteration_end(self, trainer: Trainer, metrics: dict[str, float]) -> None:
        """Draw if it is time."""
        if trainer.stopping or time.monotonic() - self._drawn > trainer.config.logger.plot_every:
            self.draw(trainer)
            self._drawn = time.monotonic()

    def draw(self, trainer: Trainer) -> None:
        """Draw the learning curves, if metrics are written to a file, and the curriculum, if there is one."""
        run = trainer.run
        if trainer.config.logger.jsonl:
            with self._curves:
                mdp = trainer.env.mdp
                shown = mdp.definition.metrics_of(mdp.definition.progress)
                plot_learning_curves(run.metrics_file, run.curves_png, run.path.name, shown, mdp.context.layout)
        if trainer.curriculum is not None:
            with self._map:
                trainer.curriculum.draw(run.curriculum_png, f"{run.path.name}, {format_count(trainer.frames)} steps")


def make_callbacks(names: Sequence[str]) -> list[Callback]:
    """Make the callbacks that the settings name.

    Args:
        names: The setting ``callbacks``: registered names, or ``module:Class``.

    Raises:
        ConfigError: There is no such class, it overrides no method of `Callback`, or it cannot be made.
    """
    found: list[Callback] = []
    for name in names:
        where, cls = f"callbacks={name}", CALLBACKS.find(name, "callbacks")
        if all(getattr(cls, hook) is getattr(Callback, hook) for hook in HOOKS):
            raise ConfigError(f"{where}: {cls.__name__} does nothing; override one of {', '.join(HOOKS)}")
        found.append(made(cls, where))
    return found


def arrange_callbacks(callbacks: Iterable[Callback] = ()) -> list[Callback]:
    """Return the default callbacks and a user's, in the order in which they run.

    A user's callback runs after the evaluation and before the metrics are logged. One that is a subclass of a default
    one takes its place.

    Args:
        callbacks: The user's.
    """
    own = list(callbacks)

    def default(kind: type[Callback]) -> list[Callback]:
        chosen = [callback for callback in own if isinstance(callback, kind)]
        own[:] = [callback for callback in own if callback not in chosen]
        return chosen or [kind()]

    before = [*default(CurriculumCallback), *default(EvaluationCallback)]
    after = [*default(LoggerCallback), *default(CheckpointCallback), *default(PlotCallback)]
    return [*before, *own, *after]


def gate_reached(gate: float | None, metrics: dict[str, Any]) -> bool:
    """Return whether the metrics hold an evaluation that reached a stage's gate, a success rate."""
    return gate is not None and metrics.get("Evaluation/success", -1.0) >= gate
