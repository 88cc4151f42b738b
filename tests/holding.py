"""A callback that lets a test end a training in its middle, however fast the machine is."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from skatemount.training.callbacks import Callback

HOLD = "hold"
"""A file in the working directory; while it is there, trainings stand still after their first checkpoint."""


class Holds(Callback):
    """Stands still in the iteration after the first checkpoint, until the file is gone or the process ends."""

    def on_batch_collected(self, trainer: Any, batch: Any) -> None:
        """Wait while the file is there."""
        while trainer.saved_frames and Path(HOLD).exists():
            time.sleep(0.05)
