"""A callback: end a training that has stopped getting better."""

from __future__ import annotations

from typing import Any

from skatemount.evaluation.results import Evaluation
from skatemount.training.callbacks import Callback
from skatemount.training.trainer import Trainer


class Patience(Callback):
    """Ends the training after three evaluations in a row without a new best success rate."""

    limit = 3

    def __init__(self) -> None:
        self.best, self.waited = -1.0, 0

    def on_evaluation_end(self, trainer: Trainer, evaluation: Evaluation) -> None:
        """Count, and end the training if it is time."""
        self.waited = 0 if evaluation.success_rate > self.best else self.waited + 1
        self.best = max(self.best, evaluation.success_rate)
        if self.waited == self.limit:
            trainer.stop()

    def state_dict(self) -> dict[str, Any]:
        """Return what a resumed run has to know."""
        return {"best": self.best, "waited": self.waited}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` returned."""
        self.best, self.waited = state["best"], state["waited"]
