"""Show on a terminal how a training goes."""

from __future__ import annotations

import math
import time

from rich.console import Console
from rich.live import Live
from rich.markup import escape
from rich.progress_bar import ProgressBar
from rich.table import Table

from skatemount.runs.loggers import as_number
from skatemount.utils.formatting import format_count, format_duration


class Progress:
    """Shows how a training goes: a live table on a terminal, else a plain line now and then."""

    def __init__(
        self,
        total_frames: int,
        title: str,
        every_s: float = 5.0,
        initial_frames: int = 0,
        console: Console | None = None,
    ) -> None:
        """Prepares the display; nothing is shown before the first report.

        Args:
            total_frames: Environment steps at which the training ends.
            title: What is trained.
            every_s: Least time between two plain lines, in seconds.
            initial_frames: Environment steps already done when resuming, for the time left.
            console: Where to show it; standard output if not given.
        """
        self._total = total_frames
        self._title = title
        self._every_s = every_s
        self._initial = initial_frames
        self._console = console or Console()
        self._started = time.monotonic()
        self._metrics: dict[str, float] = {}
        self._frames = initial_frames
        self._line_at = -math.inf
        self._line_frames: int | None = None
        self._live: Live | None = None

    def update(self, frames: int, metrics: dict[str, float]) -> None:
        """Takes in one report; a metric that is not in it keeps its last value.

        Args:
            frames: Environment steps so far.
            metrics: Numbers by name, as for `MetricsLog.log`.
        """
        self._frames = frames
        self._metrics.update({name: as_number(name, value) for name, value in metrics.items()})
        if self._console.is_terminal:
            if self._live is None:
                # Without its own thread: that would compete with the physics.
                self._live = Live(console=self._console, auto_refresh=False)
                self._live.start()
            self._live.update(self._table(), refresh=True)
        elif time.monotonic() - self._line_at >= self._every_s:
            self._print_line()

    def close(self) -> None:
        """Leaves the last state on display."""
        if self._live is not None:
            self._live.stop()
            self._live = None
        elif self._metrics and not self._console.is_terminal and self._line_frames != self._frames:
            self._print_line()

    def __enter__(self) -> Progress:
        """Returns itself, to be closed at the end of a `with` block."""
        return self

    def __exit__(self, *_: object) -> None:
        """Closes the display."""
        self.close()

    def _print_line(self) -> None:
        done = min(self._frames / max(self._total, 1), 1.0)
        head = f"{self._title}  {format_count(self._frames)}/{format_count(self._total)} ({done:.0%})"
        cells = [f"{name} {value}" for name, value in self._cells().items()]
        print("  ".join([head, *cells]), file=self._console.file, flush=True)
        self._line_at = time.monotonic()
        self._line_frames = self._frames

    def _table(self) -> Table:
        grid = Table.grid(padding=(0, 2))
        for _ in range(2):
            grid.add_column(style="dim", min_width=9)
            grid.add_column(style="bold", justify="right", min_width=9)
        cells = list(self._cells().items())
        half = (len(cells) + 1) // 2
        for i in range(half):
            grid.add_row(*cells[i], *(cells[i + half] if i + half < len(cells) else ("", "")))
        panel = Table.grid()
        done = f"{format_count(self._frames)} of {format_count(self._total)} steps"
        panel.add_row(f"[bold]{escape(self._title)}[/bold]  {done}")
        panel.add_row(ProgressBar(total=max(self._total, 1), completed=self._frames, width=46))
        panel.add_row(grid)
        return panel

    def _cells(self) -> dict[str, str]:
        """Names and values to show, only those that are known."""
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
            "feet": (get("Success/feet_on_board"), "{:.2f}".format),
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
