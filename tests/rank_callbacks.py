"""Callbacks for the tests of several ranks; the settings name them, because every rank makes its own."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import Any

import torch

from skatemount.training.callbacks import Callback


class OnOneRank(Callback):
    """Does something on rank 1 before its third batch is learned from, once in a run.

    Attributes:
        signum: Signal that `act` sends.
        at: Number of iterations before.
    """

    on_all_ranks = True
    at = 2
    signum: int | None = None

    def on_batch_collected(self, trainer: Any, batch: Any) -> None:
        """Do it, and note in the run's folder that it was done."""
        if trainer.ranks.rank == 1 and trainer.iteration == self.at:
            note = trainer.run.path.parent / type(self).__name__
            if not note.exists():
                note.touch()
                self.act(trainer, batch)

    def act(self, trainer: Any, batch: Any) -> None:
        """Send the signal to this process."""
        assert self.signum is not None
        os.kill(os.getpid(), self.signum)


class Killed(OnOneRank):
    """Rank 1 is killed."""

    signum = signal.SIGKILL


class AskedToEndInEvaluation(Callback):
    """Rank 0 is asked to end when it begins to evaluate."""

    def on_iteration_end(self, trainer: Any, metrics: dict[str, float]) -> None:
        """Ask it, and evaluate more episodes than the test has time for."""
        os.kill(os.getpid(), signal.SIGTERM)
        trainer.evaluate(1_000_000)


class KilledLater(Killed):
    """Rank 1 is killed in an iteration that the run of the tests reaches only when it is resumed."""

    at = 4


class KilledAtEnd(Callback):
    """Rank 0 is killed when everything is trained and saved, once in a run."""

    def on_train_end(self, trainer: Any) -> None:
        """Kill it."""
        note = trainer.run.path.parent / type(self).__name__
        if not note.exists():
            note.touch()
            os.kill(os.getpid(), signal.SIGKILL)


class Stopped(OnOneRank):
    """Rank 1 stands still."""

    signum = signal.SIGSTOP


class AskedToEnd(OnOneRank):
    """Rank 1 alone is asked to end."""

    signum = signal.SIGTERM


class Stops(OnOneRank):
    """Rank 1 alone stops the training."""

    def act(self, trainer: Any, batch: Any) -> None:
        """Stop it."""
        trainer.stop()


class Poisoned(OnOneRank):
    """A reward of rank 1 is not a number."""

    def act(self, trainer: Any, batch: Any) -> None:
        """Change the batch."""
        batch["next", "reward"][0, 0] = torch.nan


class Drifts(OnOneRank):
    """A weight of rank 1 changes."""

    def on_batch_collected(self, trainer: Any, batch: Any) -> None:
        """Change the weight."""
        if trainer.ranks.rank == 1 and trainer.iteration == 2:
            with torch.no_grad():
                next(trainer.networks.parameters()).view(-1)[0] += 1e-4


class HandsOver(Callback):
    """Lets a single process write its first batch, and each rank of several learn from its part of it."""

    on_all_ranks = True
    file = "batch.pt"

    def on_batch_collected(self, trainer: Any, batch: Any) -> None:
        """Write the batch, or replace it."""
        path = Path(trainer.config.logger.root) / self.file
        if trainer.ranks.size == 1:
            torch.save(batch, path)
            return
        whole = torch.load(path, weights_only=False)
        n = len(batch)
        batch.update_(whole[trainer.ranks.rank * n : (trainer.ranks.rank + 1) * n])
