"""Loggers: where the metrics of a training go."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from skatemount.runs.metrics import MetricsFile
from skatemount.utils.errors import ConfigError

if TYPE_CHECKING:
    from skatemount.runs.folder import RunFolder


class Logger(Protocol):
    """Receives the metrics of every iteration."""

    def log(self, metrics: dict[str, float], frames: int) -> None:
        """Write the metrics of an iteration.

        Args:
            metrics: Numbers by name.
            frames: Environment steps so far.
        """
        ...

    def close(self) -> None:
        """Flush and close; a second call does nothing."""
        ...


class TensorBoardLogger:
    """Writes TensorBoard events into a run folder.

    TorchRL's logger writes into a folder of its own, and cannot drop the events of a run that is resumed from an
    earlier checkpoint.
    """

    def __init__(self, run: RunFolder, resume_at: int | None = None) -> None:
        """Open the event file.

        Args:
            run: The run folder.
            resume_at: Environment steps of the checkpoint that a run resumes from; later events are dropped.

        Raises:
            ConfigError: TensorBoard is not installed.
        """
        try:
            from torch.utils.tensorboard import SummaryWriter  # slow to import
        except ImportError as error:
            raise ConfigError(
                "logger.tensorboard=true: the package tensorboard is not installed: pip install tensorboard, or "
                "logger.tensorboard=false"
            ) from error
        # TensorBoard drops events from `purge_step` on, that step included.
        self._events = SummaryWriter(str(run.path), purge_step=None if resume_at is None else resume_at + 1)

    def log(self, metrics: dict[str, float], frames: int) -> None:
        """Write one event for each metric; see `Logger.log`."""
        for name, value in metrics.items():
            self._events.add_scalar(name, value, global_step=frames)

    def close(self) -> None:
        """Flush and close."""
        self._events.close()


def open_loggers(run: RunFolder, file: bool = True, tensorboard: bool = True, frames: int = 0) -> list[Logger]:
    """Open the loggers of a run.

    A logger for another service implements `Logger` and is opened here.

    Args:
        run: The run folder.
        file: Write `metrics.jsonl`.
        tensorboard: Write TensorBoard events.
        frames: Environment steps that are already trained; what was logged beyond is dropped.

    Raises:
        ConfigError: TensorBoard is asked for and not installed.
    """
    resume_at = frames or None
    loggers: list[Logger] = []
    if tensorboard:
        loggers.append(TensorBoardLogger(run, resume_at))
    if file:
        loggers.append(MetricsFile(run.path / "metrics.jsonl", resume_at))
    return loggers


def as_numbers(metrics: dict[str, float]) -> dict[str, float]:
    """Return metrics as Python floats, from numbers of Python and numpy and tensors of one element.

    Raises:
        ValueError: A value is not a number; the message names the metric.
    """
    values = {}
    for name, value in metrics.items():
        try:
            values[name] = float(value)
        except (TypeError, ValueError) as error:
            raise ValueError(f"metric {name}={value!r}: a number is needed") from error
    return values
