"""What a training writes down while it runs: a table of metrics, and TensorBoard events."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from skatemount.runs.metrics import MetricsCsv
from skatemount.utils.errors import ConfigError

if TYPE_CHECKING:
    from torch.utils.tensorboard import SummaryWriter

    from skatemount.runs.folder import RunFolder


class MetricsLog:
    """Writes metrics to `metrics.csv` and to TensorBoard event files, by environment steps.

    TensorBoard is written through `torch.utils.tensorboard` rather than TorchRL's logger: events
    then lie in the run folder itself, and a resume_config run can say which earlier ones to forget.
    """

    def __init__(
        self,
        run: RunFolder,
        tensorboard: bool = True,
        csv: bool = True,
        resume_at: int | None = None,
    ) -> None:
        """Opens the logs.

        Args:
            run: The run folder that they are in.
            tensorboard: Whether to write TensorBoard events.
            csv: Whether to write `metrics.csv`.
            resume_at: Environment steps of the checkpoint that a resume_config run goes on from; what was
                logged beyond it is dropped.

        Raises:
            ConfigError: TensorBoard is asked for and not installed.
        """
        self._csv = MetricsCsv(run.metrics_csv, resume_at) if csv else None
        self._events = _event_writer(run.path, resume_at) if tensorboard else None

    def log(self, metrics: dict[str, float], frames: int) -> None:
        """Writes one report.

        Args:
            metrics: Numbers by name (Python, numpy or one-element tensors).
            frames: Environment steps so far.

        Raises:
            ValueError: A value is not a number.
        """
        values = {name: as_number(name, value) for name, value in metrics.items()}
        if self._csv is not None:
            self._csv.append(values, frames)
        if self._events is not None:
            for name, value in values.items():
                self._events.add_scalar(name, value, global_step=frames)

    def close(self) -> None:
        """Flushes and closes the logs; harmless when called again."""
        if self._csv is not None:
            self._csv.close()
        if self._events is not None:
            self._events.close()

    def __enter__(self) -> MetricsLog:
        """Returns itself, to be closed at the end of a `with` block."""
        return self

    def __exit__(self, *_: object) -> None:
        """Closes the logs."""
        self.close()


def as_number(name: str, value: float) -> float:
    """Return a metric as a float; `ValueError` if it is none."""
    try:
        return float(value)
    except (TypeError, ValueError) as error:
        raise ValueError(f"metric {name}={value!r}: a number is needed") from error


def _event_writer(folder: Path, resume_at: int | None) -> SummaryWriter:
    try:
        from torch.utils.tensorboard import SummaryWriter  # slow to import
    except ImportError as error:
        raise ConfigError(
            "logger.tensorboard=true: the package tensorboard is not installed: pip install tensorboard, or "
            "logger.tensorboard=false"
        ) from error
    # TensorBoard forgets events from `purge_step` on, that step included.
    return SummaryWriter(str(folder), purge_step=None if resume_at is None else resume_at + 1)
