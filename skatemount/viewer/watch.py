"""A training that runs, followed through the files of its run."""

from __future__ import annotations

import html
import json
import math
import time
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from PIL import Image

from skatemount.runs.find import find_checkpoint
from skatemount.runs.folder import RunFolder, age_key, is_run
from skatemount.runs.metrics import STEP
from skatemount.utils.errors import ConfigError
from skatemount.utils.formatting import format_count
from skatemount.viewer.session import Session

EVERY = 2.0
"""Time between two looks at the run's folder, s."""

PICTURE_WIDTH = 900
"""Largest width of a picture in the page, pixels."""

CURVES = {
    "success": {"Success/rate": "training", "Evaluation/success": "evaluated"},
    "reward of an episode": {"Train/mean_reward": "training"},
    "curriculum": {"Curriculum/bins_open": "open", "Curriculum/bins_solved": "solved"},
}
"""Metrics of each plot, with their labels."""

LISTED = ("Success/", "Evaluation/success", "Train/mean", "Curriculum/", "Perf/total_fps")
"""Beginnings of the metrics whose last values are listed."""


def find_run(spec: str, root: Path | str) -> Path:
    """Return the folder of the run that a user wants to follow, which may have no checkpoint yet.

    Args:
        spec: ``latest``, or a run as a path or relative to ``root``.
        root: Folder of all runs.

    Raises:
        ConfigError: There is no such run.
    """
    root = Path(root)
    if spec == "latest":
        runs = filter(is_run, root.glob("*/*"))
        newest = max(runs, key=age_key, default=None)
        if newest is None:
            raise ConfigError(f"run=latest: there is no run in {root}")
        return newest
    for path in (Path(spec), root / spec):
        if is_run(path):
            return path
    # The message lists what there is.
    return RunFolder.open(find_checkpoint(spec, root, "run")).path


class MetricsTail:
    """Reads a growing `metrics.jsonl`, only what was added each time.

    Args:
        path: The file, which need not exist yet.

    Attributes:
        rows: The lines so far.
    """

    def __init__(self, path: Path):
        self.path = path
        self.rows: list[dict[str, float]] = []
        self._read = 0

    def update(self) -> bool:
        """Read the lines that were added, and return whether there were any."""
        try:
            size = self.path.stat().st_size
        except OSError:
            return False
        if size < self._read:
            # A training that resumes cuts the file.
            self.rows, self._read = [], 0
        if size == self._read:
            return False
        with self.path.open("rb") as file:
            file.seek(self._read)
            data = file.read()
        whole = data[: data.rfind(b"\n") + 1]
        self._read += len(whole)
        for line in whole.decode(errors="replace").splitlines():
            try:
                self.rows.append(
                    {name: math.nan if value is None else value for name, value in json.loads(line).items()}
                )
            except (ValueError, AttributeError):
                continue
        return bool(whole)

    def curves(self, names: Iterable[str], most: int = 400) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Return frames, in millions, and values of those metrics that there are; at most about ``most`` of each.

        Args:
            names: Names of metrics. A line that lacks one has no value of it.
            most: Number of values.
        """
        found = {}
        for name in names:
            points = [(row[STEP], row[name]) for row in self.rows if math.isfinite(row.get(name, math.nan))]
            if points:
                frames, values = np.array(points[:: 1 + len(points) // most], float).T
                found[name] = (frames / 1e6, values)
        return found


class RunWatcher:
    """Follows a run: its newest checkpoint acts, and its metrics and pictures are shown.

    Args:
        run: Folder of the run. Of a run with parts, the newest part is followed.
        clock: A steady clock, s.

    Attributes:
        run: Folder of the run.
        tail: Its metrics.
        text: The run, the checkpoint that acts, and the last metrics, as HTML.
    """

    def __init__(self, run: Path, clock: Callable[[], float] = time.monotonic):
        self.run, self._clock = run, clock
        self._looked = -math.inf
        self._taken: Path | None = None
        self._picture = ("", 0)
        self.text = ""
        self.tail = MetricsTail(self._part.path / "metrics.jsonl")

    @property
    def _part(self) -> RunFolder:
        run = RunFolder(self.run)
        return next(reversed(run.parts), run)

    @property
    def checkpoint(self) -> Path | None:
        """The newest checkpoint; None before there is one."""
        return RunFolder(self.run).latest

    def wait_for_checkpoint(self, sleep: Callable[[float], None] = time.sleep) -> None:
        """Wait until the run has a checkpoint."""
        if self.checkpoint is None:
            print(f"waiting for the first checkpoint of {self.run}", flush=True)
        while self.checkpoint is None:
            sleep(EVERY)

    def poll(self, session: Session) -> bool:
        """Look at the run's folder if it is time to, and let its newest checkpoint act.

        Args:
            session: Gets the checkpoint as an action.

        Returns:
            True if there are new metrics.
        """
        if self._clock() - self._looked < EVERY:
            return False
        self._looked = self._clock()
        newest = self.checkpoint
        if self._taken is None:
            self._taken = session.task.agent.path
        if newest is not None and newest != self._taken:
            self._taken = newest
            session.submit(lambda: session.choose_policy(str(newest)), "policy")
        path = self._part.path / "metrics.jsonl"
        if path != self.tail.path:
            self.tail = MetricsTail(path)
        changed = self.tail.update()
        self.text = self._in_words()
        return changed

    def plots(self) -> dict[str, dict[str, str]]:
        """Return the metrics of each plot with their labels, by the title of the plot."""
        config = RunFolder(self.run).config
        kind = (config.get("curriculum") or {}).get("kind", "none")
        return {title: names for title, names in CURVES.items() if title != "curriculum" or kind == "auto"}

    def new_picture(self) -> np.ndarray | None:
        """Return the curriculum's success map, ``[H, W, 3]``, if it was written since the last call."""
        path = self._part.curriculum_png
        try:
            found = (str(path), path.stat().st_mtime_ns)
            if found == self._picture:
                return None
            self._picture = found
            with Image.open(path) as file:
                picture = file.convert("RGB")
                picture.thumbnail((PICTURE_WIDTH, PICTURE_WIDTH))
                return np.asarray(picture)
        except OSError:
            # There is none yet, or it is being replaced.
            return None

    def _in_words(self) -> str:
        rows = {"run": self._part.path.name, "checkpoint": self._taken.name if self._taken else "none yet"}
        last: dict[str, float] = {}
        for row in self.tail.rows[-200:]:
            last.update(row)
        if STEP in last:
            rows["frames"] = format_count(int(last[STEP]))
        for name, value in last.items():
            if name.startswith(LISTED) and math.isfinite(value):
                rows[name] = f"{value:.4g}"
        lines = "".join(
            f"<tr><td style='color:#888;padding-right:8px'>{html.escape(name)}</td><td>{html.escape(value)}</td></tr>"
            for name, value in rows.items()
        )
        return f"<div style='font-size:12px;padding:0 12px'><table id='play-training'>{lines}</table></div>"
