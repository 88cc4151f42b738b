"""Early end of hopeless trials: a callback that reports the success of a training, and asks whether to go on."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from skatemount.searching.study import POINTS, Claimed
from skatemount.training.callbacks import Callback
from skatemount.utils.errors import ConfigError

if TYPE_CHECKING:
    from skatemount.training.trainer import Trainer


class PruningCallback(Callback):
    """Reports the success of a trial at `POINTS` points of its training, and ends it if it is hopeless.

    The success is that of the last evaluation during the training, ``Evaluation/success``; with
    ``logger.evaluate_every=0`` that of the exploring policy, ``Success/rate``. At a point without a new value the last
    one counts, so that trials with batches of different sizes can be compared.

    Args:
        claimed: The trial.

    Attributes:
        pruned: The pruner has ended the trial.
    """

    def __init__(self, claimed: Claimed) -> None:
        self.pruned = False
        self._claimed = claimed
        reported = claimed.trial.study.get_trials(deepcopy=False)[claimed.trial.number].intermediate_values
        # The training may resume from a checkpoint before the last point.
        self._point = max(reported, default=0)
        self._last = reported.get(self._point, math.nan)

    def on_iteration_end(self, trainer: Trainer, metrics: dict[str, float]) -> None:
        """Report the success if a point is reached, and end the training if the pruner says so."""
        if not self._claimed.sign.is_mine:
            # The run is another process's now: nothing more is saved in it.
            trainer.saved_frames = trainer.frames
            raise TakenOver("another process has taken this trial over")
        value = success_of(metrics, bool(trainer.config.logger.evaluate_every))
        point = math.floor(POINTS * min(1.0, trainer.frames / trainer.config.total_frames))
        for each in range(self._point + 1, point + 1):
            known = value if each == point and not math.isnan(value) else self._last
            if not math.isnan(known):
                self._claimed.trial.report(known, each)
        if not math.isnan(value):
            self._last = value
        if point > self._point and not trainer.stopping and self._claimed.trial.should_prune():
            self.pruned = True
            trainer.stop()
        self._point = max(point, self._point)

    def on_train_end(self, trainer: Trainer) -> None:
        """Leave out the final evaluation of a hopeless trial."""
        if self.pruned:
            trainer.config.logger.final_episodes = 0


class TakenOver(ConfigError):
    """Another process trains this trial now, because this one gave no sign of life for too long."""


def success_of(metrics: Mapping[str, float], evaluates: bool) -> float:
    """Return the success that an iteration has measured; not a number if it has measured none.

    Args:
        metrics: Metrics of the iteration.
        evaluates: The training has evaluations.
    """
    return float(metrics.get("Evaluation/success" if evaluates else "Success/rate", math.nan))
