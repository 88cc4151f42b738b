"""Show on a terminal how a training goes."""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Sequence

from rich.console import Console
from rich.live import Live
from rich.markup import escape
from rich.progress_bar import ProgressBar
from rich.table import Table

from skatemount.envs.tasks import Metric
from skatemount.utils.decoration import Decoration
from skatemount.utils.formatting import format_count, format_duration


def _console() -> Console:
    """Return standard output as a console that is interactive only if it is a terminal whose cursor can move.

    Rich alone would take FORCE_COLOR, which build machines set, for a terminal, and write cursor codes into log files.
    """
    moves = os.environ.get("TERM", "").lower() not in ("dumb", "unknown")
    return Console(force_terminal=moves and sys.stdout.isatty())


class Progress:
    """Display of a training's progress: a live table on a terminal, else a plain line every few seconds."""

    def __init__(
        self,
        total_frames: int,
        title: str,
        every_s: float = 5.0,
        initial_frames: int = 0,
        console: Console | None = None,
        metrics: Sequence[Metric] = (),
    ) -> None:
        """Prepare the display; it shows nothing before the first report.

        Args:
            total_frames: Environment steps at which the training ends.
            title: Name of the training.
            every_s: Least time between two plain lines, in seconds.
            initial_frames: Environment steps already trained when a run resumes, for the time left.
            console: Output; standard output if not given.
            metrics: The task's metrics to show: ``Success/<name>``, or the last ``Evaluation/<name>`` without it.
        """
        self._total = total_frames
        self._title = title
        self._every_s = every_s
        self._initial = initial_frames
        self._console = console or _console()
        self._started = time.monotonic()
        self._task_metrics = metrics
        self._metrics: dict[str, float] = {}
        self._frames = initial_frames
        self._evaluated: int | None = None
        self._evaluating = "evaluating"
        self._line_at = -math.inf
        self._line_frames: int | None = initial_frames
        self._live: Live | None = None
        self._shown = Decoration("the display of the progress")

    def log(self, metrics: dict[str, float], frames: int) -> None:
        """Show the metrics of an iteration; a metric that is missing keeps its last value.

        Args:
            metrics: Numbers by name.
            frames: Environment steps so far.
        """
        self._frames = frames
        self._metrics.update(metrics)
        self._evaluated = None
        with self._shown:
            if self._console.is_terminal:
                self._refresh()
            elif self._is_time():
                self._print_line()

    def show_final_evaluation(self, done: int, total: int) -> None:
        """Show how much of the evaluation at the end is done; see `show_evaluation`."""
        self._evaluating = "final evaluation"
        self.show_evaluation(done, total)

    def show_evaluation(self, done: int, total: int) -> None:
        """Show how much of an evaluation is done; for `Evaluator.run`.

        Args:
            done: Control steps done.
            total: Control steps to do.
        """
        percent = 100 * done // total
        if percent == self._evaluated:
            return
        self._evaluated = percent
        with self._shown:
            if self._console.is_terminal:
                self._refresh()
            elif self._is_time():
                self._print(f"{self._title}  {self._evaluating} {percent}%")

    def close(self) -> None:
        """Leave the last state on display."""
        live, self._live = self._live, None
        with self._shown:
            if live is not None:
                live.stop()
            elif not self._console.is_terminal and self._line_frames != self._frames:
                self._print_line()
        self._metrics = {}

    def __enter__(self) -> Progress:
        """Return itself; the `with` block closes it."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the display."""
        self.close()

    def _is_time(self) -> bool:
        return time.monotonic() - self._line_at >= self._every_s

    def _print(self, line: str) -> None:
        print(line, file=self._console.file, flush=True)
        self._line_at = time.monotonic()

    def _print_line(self) -> None:
        done = min(self._frames / max(self._total, 1), 1.0)
        head = f"{self._title}  {format_count(self._frames)}/{format_count(self._total)} ({done:.0%})"
        self._print("  ".join([head, *(f"{name} {value}" for name, value in self._cells().items())]))
        self._line_frames = self._frames

    def _refresh(self) -> None:
        if self._live is None:
            # Without a thread of its own, which would compete with the physics.
            self._live = Live(console=self._console, auto_refresh=False)
            self._live.start()
        self._live.update(self._table(), refresh=True)

    def _table(self) -> Table:
        panel = Table.grid()
        done = f"{format_count(self._frames)} of {format_count(self._total)} steps"
        panel.add_row(f"[bold]{escape(self._title)}[/bold]  {done}")
        if self._metrics:
            panel.add_row(ProgressBar(total=max(self._total, 1), completed=self._frames, width=46))
            panel.add_row(self._grid())
        if self._evaluated is not None:
            panel.add_row(f"{self._evaluating} {self._evaluated}%")
            panel.add_row(ProgressBar(total=100, completed=self._evaluated, width=46))
        return panel

    def _grid(self) -> Table:
        grid = Table.grid(padding=(0, 2))
        for _ in range(2):
            grid.add_column(style="dim", min_width=9)
            grid.add_column(style="bold", justify="right", min_width=9)
        cells = list(self._cells().items())
        half = (len(cells) + 1) // 2
        for i in range(half):
            grid.add_row(*cells[i], *(cells[i + half] if i + half < len(cells) else ("", "")))
        return grid

    def _cells(self) -> dict[str, str]:
        """Return the names and values that are known."""
        own = time.monotonic() - self._started
        rate = (self._frames - self._initial) / own if own > 0 else 0.0
        get = self._metrics.get
        left = (self._total - self._frames) / rate if rate > 0 else math.nan
        values = {
            "steps/s": (get("Perf/total_fps", rate), format_count),
            "reward": (get("Train/mean_reward"), "{:.2f}".format),
            "length": (get("Train/mean_episode_length"), "{:.0f}".format),
            "success": (get("Success/rate"), "{:.2f}".format),
            "evaluated": (get("Evaluation/success"), "{:.2f}".format),
            **{
                each.label: (get(f"Success/{each.name}", get(f"Evaluation/{each.name}")), each.short)
                for each in self._task_metrics
            },
            "kl": (get("Loss/kl"), "{:.4f}".format),
            "lr": (get("Loss/learning_rate"), "{:.1e}".format),
            "std": (get("Policy/mean_std"), "{:.2f}".format),
            "elapsed": (get("Perf/elapsed_s", own), format_duration),
            "left": (max(left, 0.0), format_duration),
        }
        return {
            name: "-" if math.isnan(value) else form(value)
            for name, (value, form) in values.items()
            if value is not None
        }
