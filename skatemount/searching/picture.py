"""Picture of a search: its history, and the success at each value of each setting."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skatemount.config.search import Dimension
from skatemount.runs import atomic

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FINISHED, PRUNED, FAILED, BEST = "#1f77b4", "#ff7f0e", "#d62728", "#2ca02c"
COLUMNS = 3
MAX_PANELS = 8
"""Settings that have a panel each; the first ones by their names."""


def draw(records: Sequence[Mapping[str, Any]], dimensions: Sequence[Dimension], path: Path, title: str) -> None:
    """Draw the success of each trial with the best so far, and for each setting the success at its values.

    Args:
        records: Records of the trials, see `skatemount.searching.results.records_of`.
        dimensions: The space.
        path: The picture, replaced in one step.
        title: Title of the picture.
    """
    # The object interface: no global figure list, no display, safe beside a user's own plots.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    shown = list(dimensions)[:MAX_PANELS]
    rows = math.ceil((1 + len(shown)) / COLUMNS)
    columns = min(COLUMNS, 1 + len(shown))
    figure = Figure(figsize=(4 * columns, 3.1 * rows), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=12, parse_math=False)
    axes = list(figure.subplots(rows, columns, squeeze=False).flat)
    bottom = _bottom(records)
    _draw_history(axes[0], records, bottom)
    for axis, dimension in zip(axes[1:], shown):
        _draw_slice(axis, records, dimension)
    for axis in axes[1 + len(shown) :]:
        axis.set_visible(False)
    for axis in axes:
        axis.set_ylim(bottom, 1.04 - 0.04 * max(bottom, 0))
        axis.grid(alpha=0.25)
        axis.tick_params(labelsize=8)
    with atomic.replacing(path) as temporary:
        figure.savefig(temporary, format="png")


def _bottom(records: Sequence[Mapping[str, Any]]) -> float:
    """Return the lower end of the axis of success: the whole range unless every trial is near 1."""
    least = min((each["success"] for each in records if each["success"] is not None), default=0.0)
    return -0.04 if least < 0.5 else least - 0.15 * (1.001 - least)


def _draw_history(axis: Axes, records: Sequence[Mapping[str, Any]], bottom: float) -> None:
    from matplotlib.ticker import MaxNLocator

    for status, color in (("finished", FINISHED), ("pruned", PRUNED)):
        those = [each for each in records if each["status"] == status and each["success"] is not None]
        if those:
            axis.scatter([r["number"] for r in those], [r["success"] for r in those], s=18, color=color, label=status)
    failed = [each["number"] for each in records if each["status"] == "failed"]
    if failed:
        axis.scatter(failed, [max(bottom, 0.0)] * len(failed), s=24, color=FAILED, marker="x", label="failed")
    numbers: list[int] = []
    highest: list[float] = []
    for each in records:
        if each["status"] == "finished":
            numbers.append(each["number"])
            highest.append(max(each["success"], highest[-1] if highest else 0.0))
    axis.step(numbers, highest, where="post", color=BEST, label="best so far")
    axis.set_title("success of each trial", fontsize=10)
    axis.set_xlabel("trial", fontsize=9)
    axis.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    axis.legend(fontsize=7, loc="best", framealpha=0.6)


def _draw_slice(axis: Axes, records: Sequence[Mapping[str, Any]], dimension: Dimension) -> None:
    from matplotlib.ticker import MaxNLocator

    places = {text: i for i, text in enumerate(dimension.choices)}
    for status, color in (("pruned", PRUNED), ("finished", FINISHED)):
        those = [each for each in records if each["status"] == status and each["success"] is not None]
        values = [each["settings"][dimension.key] for each in those]
        x = [places[value] for value in values] if places else values
        axis.scatter(x, [each["success"] for each in those], s=18, color=color)
    if places:
        axis.set_xticks(range(len(places)), [text if len(text) < 14 else f"{text[:12]} …" for text in places])
        axis.set_xlim(-0.5, len(places) - 0.5)
    else:
        low, high = dimension.low, dimension.high
        if dimension.log:
            axis.set_xscale("log")
            # Ticks of a range of less than a factor of ten would lie on each other.
            ticks = [low, math.sqrt(low * high), high]
            axis.set_xticks(ticks, [f"{tick:.3g}" for tick in ticks])
            axis.minorticks_off()
            axis.set_xlim(low * (low / high) ** 0.04, high * (high / low) ** 0.04)
        else:
            axis.xaxis.set_major_locator(MaxNLocator(5, integer=dimension.kind == "int"))
            axis.set_xlim(low - 0.04 * (high - low), high + 0.04 * (high - low))
    axis.set_title(dimension.key, fontsize=10)
