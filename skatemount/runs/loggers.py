"""Loggers: where the metrics of a training go."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol

from skatemount.runs.metrics import MetricsFile
from skatemount.utils.classes import ClassRegistry, made
from skatemount.utils.decoration import Decoration
from skatemount.utils.errors import ConfigError

if TYPE_CHECKING:
    from skatemount.runs.folder import RunFolder


LOGGERS = ClassRegistry(
    "logger",
    {
        "tensorboard": "skatemount.runs.loggers:TensorBoardLogger",
        "jsonl": "skatemount.runs.loggers:JsonLinesLogger",
        "wandb": "skatemount.runs.trackers:WandbLogger",
        "trackio": "skatemount.runs.trackers:TrackioLogger",
    },
    methods=("log", "close"),
    base="skatemount.runs.loggers.Logger",
)
"""Loggers by name."""


class Logger(Protocol):
    """Receives the metrics of every iteration.

    The constructor of one's own logger takes the `RunFolder`, and ``resume_at``: the environment steps of the
    checkpoint that the run resumes from, or None. What was logged beyond them happens again.

    A logger that fails does not end a training: the first error is shown as a warning. The file ``metrics.jsonl`` is
    the exception.
    """

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


class JsonLinesLogger(MetricsFile):
    """Writes ``metrics.jsonl`` into a run folder; see `MetricsFile`."""

    def __init__(self, run: RunFolder, resume_at: int | None = None) -> None:
        """Open the file; the arguments are those of `TensorBoardLogger`."""
        super().__init__(run.path / "metrics.jsonl", resume_at)


def open_loggers(
    run: RunFolder, file: bool = True, tensorboard: bool = True, frames: int = 0, others: Sequence[str] = ()
) -> list[Logger]:
    """Open the loggers of a run.

    Args:
        run: The run folder.
        file: Write `metrics.jsonl`.
        tensorboard: Write TensorBoard events.
        frames: Environment steps that are already trained; what was logged beyond is dropped.
        others: Further loggers, by their names in ``logger.loggers``.

    Raises:
        ConfigError: A logger cannot be made, such as TensorBoard where it is not installed.
        OSError: ``metrics.jsonl`` cannot be written.
    """
    names = [*(["tensorboard"] if tensorboard else []), *(["jsonl"] if file else [])]
    with contextlib.ExitStack() as opened:
        loggers: list[Logger] = []
        for name in [*names, *others]:
            where = f"logger.{name}" if name in names else "logger.loggers"
            cls = LOGGERS.find(name, where)
            try:
                loggers.append(made(cls, f"{where}={name}", run, frames or None))
            except ConfigError:
                raise
            except Exception as error:
                if issubclass(cls, MetricsFile):
                    raise
                # A server that does not answer is no reason to train nothing.
                Decoration(f"opening the logger {name}").warn(error)
            else:
                opened.callback(loggers[-1].close)
        opened.pop_all()
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
