"""The metrics' table of a run: one row a report, columns that may grow, safe if cut off."""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path

import numpy as np

from skatemount.runs import atomic
from skatemount.utils.errors import ConfigError

STEP = "frames"


class MetricsCsv:
    """Appends rows to a CSV file whose first column is `frames` (environment steps).

    A metric that was not reported leaves its cell empty. When a new metric appears the file is
    rewritten with one more column, in one step.
    """

    def __init__(self, path: Path, resume_at: int | None = None) -> None:
        """Opens or starts the table.

        Args:
            path: The file.
            resume_at: When going on from a checkpoint, its environment steps: rows beyond it, which
                the resume_config run will write again, are dropped.
        """
        self.path = path
        self._columns: list[str] = [STEP]
        rows: list[dict[str, str]] = []
        if path.exists():
            self._columns, rows = _read(path)
            limit = math.inf if resume_at is None else resume_at
            rows = [row for row in rows if float(row[STEP]) <= limit]
        self._rewrite(rows)
        self._file = path.open("a", encoding="utf-8", newline="")

    def append(self, metrics: dict[str, float], frames: int) -> None:
        """Adds one row and hands it to the operating system.

        Args:
            metrics: Values by column.
            frames: Environment steps so far.
        """
        if new := [name for name in metrics if name not in self._columns]:
            self._file.close()
            _, rows = _read(self.path)
            self._columns += new
            self._rewrite(rows)
            self._file = self.path.open("a", encoding="utf-8", newline="")
        row = {STEP: str(frames), **{name: repr(value) for name, value in metrics.items()}}
        self._file.write(_line([row.get(name, "") for name in self._columns]))
        self._file.flush()

    def close(self) -> None:
        """Closes the file."""
        self._file.close()

    def _rewrite(self, rows: list[dict[str, str]]) -> None:
        lines = [self._columns, *([row.get(name, "") for name in self._columns] for row in rows)]
        atomic.write_text(self.path, "".join(map(_line, lines)))


def read_metrics(path: Path) -> dict[str, np.ndarray]:
    """Reads a metrics table.

    Args:
        path: The CSV file.

    Returns:
        A float64 array of shape [rows] for each column, not-a-number where a cell is empty.

    Raises:
        ConfigError: The file is missing or has no `frames` column.
    """
    try:
        columns, rows = _read(path)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from error
    return {name: np.array([_number(row[name]) for row in rows], float) for name in columns}


def _read(path: Path) -> tuple[list[str], list[dict[str, str]]]:
    """Reads columns and rows, leaving out a last row that a crash cut off."""
    text = path.read_text(encoding="utf-8")
    lines = list(csv.reader(io.StringIO(text[: text.rfind("\n") + 1], newline="")))
    if not lines and not text:
        return [STEP], []
    if not lines or lines[0][:1] != [STEP]:
        raise ConfigError(f"{path}: not a metrics table, its first column has to be {STEP!r}")
    columns = lines[0]
    whole = (row for row in lines[1:] if len(row) == len(columns))
    rows = [dict(zip(columns, row, strict=True)) for row in whole]
    return columns, [row for row in rows if math.isfinite(_number(row[STEP]))]


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.nan


def _line(cells: list[str]) -> str:
    buffer = io.StringIO(newline="")
    csv.writer(buffer, lineterminator="\n").writerow(cells)
    return buffer.getvalue()
