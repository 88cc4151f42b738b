"""The metrics of a run: one JSON object a line, appended and never rewritten while a training runs."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import numpy as np

from skatemount.runs import atomic
from skatemount.utils.errors import ConfigError

STEP = "frames"
OLD_SUFFIX = ".csv"
"""Older versions wrote `metrics.csv`."""


class MetricsFile:
    """Appends metrics to a file whose lines are ``{"frames": ..., "<metric>": ...}``.

    A number that is not finite is written as null.
    """

    def __init__(self, path: Path, resume_at: int | None = None) -> None:
        """Open or create the file.

        A last line that a crash cut off is dropped. A `metrics.csv` of an older version is converted and deleted.

        Args:
            path: The file.
            resume_at: Environment steps of the checkpoint that a run resumes from; later lines are dropped.
        """
        old = path.with_suffix(OLD_SUFFIX)
        source = path if path.exists() or not old.exists() else old
        rows = _read(source) if source.exists() else []
        rows = [row for row in rows if resume_at is None or row[STEP] <= resume_at]
        atomic.write_text(path, "".join(map(_line, rows)))
        old.unlink(missing_ok=True)
        self._path = path
        # Without a buffer: what a full disk refuses must not be tried again when the file is closed.
        self._file = path.open("ab", buffering=0)

    def log(self, metrics: dict[str, float], frames: int) -> None:
        """Write one line and hand it to the operating system.

        Args:
            metrics: Numbers by name.
            frames: Environment steps so far.

        Raises:
            OSError: The line cannot be written, such as on a full disk; it names the file.
        """
        line = memoryview(_line({STEP: frames, **metrics}).encode())
        with atomic.naming(self._path):
            while line:
                line = line[self._file.write(line) :]

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def read_metrics(path: Path) -> dict[str, np.ndarray]:
    """Read a `metrics.jsonl`, or the `metrics.csv` of an older version.

    Args:
        path: The file.

    Returns:
        For each metric a float64 array of shape [lines], nan where a line lacks it.

    Raises:
        ConfigError: The file is missing or holds something else.
    """
    try:
        rows = _read(path)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from error
    names = dict.fromkeys([STEP, *(name for row in rows for name in row)])
    return {name: np.array([row.get(name, math.nan) for row in rows], float) for name in names}


def _read(path: Path) -> list[dict[str, float]]:
    data = path.read_bytes()
    try:
        text = data[: data.rfind(b"\n") + 1].decode("utf-8")  # without a last line that a crash cut off
        lines = text.splitlines()
        if path.suffix == OLD_SUFFIX:
            header = next(csv.reader(lines[:1]), [STEP])
            cells = [dict(zip(header, row)) for row in csv.reader(lines[1:]) if len(row) == len(header)]
            return [
                {STEP: int(float(row[STEP]))} | {k: float(v) for k, v in row.items() if v and k != STEP}
                for row in cells
            ]
        rows = [{k: math.nan if v is None else v for k, v in json.loads(line).items()} for line in lines]
        return [row | {STEP: int(row[STEP])} for row in rows]
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ConfigError(f"{path}: not the metrics of a run; every line needs {STEP!r} ({error})") from error


def _line(row: dict[str, float]) -> str:
    return json.dumps({name: value if math.isfinite(value) else None for name, value in row.items()}) + "\n"
