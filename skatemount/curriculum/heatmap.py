"""A picture of a grid of start bins: where it is open, and how often starts there succeed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from torch import Tensor

from skatemount import atomic

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_BOARDS = ("fixed board", "free board")


def draw_heat_map(
    path: Path,
    title: str,
    shape: Sequence[int],
    rates: Tensor,
    opened: Tensor,
    solved: Tensor,
    distances: Sequence[float],
    headings: Sequence[float],
    heights: Sequence[float],
) -> None:
    """Draw success over distance and heading, for fixed and free boards and each height of the step.

    Bins that are not open are blank; a solved one has a black frame. The number in a bin is its success in per cent.

    Args:
        path: The picture (PNG), replaced in one step.
        title: Written above.
        shape: Of the grid: distance, heading, any others, height, board fixed or free. Over the others the mean of
            the open bins is drawn.
        rates: ``[bins]`` estimated success.
        opened: ``[bins]`` bool.
        solved: ``[bins]`` bool; drawn as solved where all of the open ones are.
        distances: Upper edges, m.
        headings: Upper edges, degrees.
        heights: Upper edges, m.
    """
    # The object interface: no global figure list, no display, safe beside a user's own plots.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    def grid(values: Tensor) -> np.ndarray:
        """``[distance, heading, height, board, others]``."""
        array = np.asarray(values.detach().cpu()).reshape(*shape[:2], -1, *shape[-2:])
        return np.moveaxis(array, 2, -1)

    is_open = grid(opened)
    count = is_open.sum(-1)
    success = np.where(count > 0, (grid(rates) * is_open).sum(-1) / np.maximum(count, 1), np.nan)
    is_solved = (count > 0) & (grid(solved) | ~is_open).all(-1)

    columns = len(heights)
    figure = Figure(figsize=(1.5 + 3.6 * columns, 5.6), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=12, parse_math=False)
    axes = figure.subplots(2, columns, squeeze=False, sharex=True, sharey=True)
    colours = Normalize(0.0, 1.0)
    low = 0.0
    for column, high in enumerate(heights):
        name = f"step of {1000 * low:.0f} to {1000 * high:.0f} mm" if column < columns - 1 else "full height"
        low = high
        for row, board in enumerate(_BOARDS):
            axis = axes[row, column]
            values = success[:, :, column, row]
            image = axis.pcolormesh(values.T, cmap="viridis", norm=colours, edgecolors="white", linewidth=0.5)
            _mark(axis, values, is_solved[:, :, column, row])
            axis.set_title(f"{board}, {name}", fontsize=9)
    for axis in axes.flat:
        axis.set_xticks(range(len(distances) + 1), [f"{d:g}" for d in (0.0, *distances)], fontsize=7)
        axis.set_yticks(range(len(headings) + 1), [f"{h:g}" for h in (0.0, *headings)], fontsize=7)
    for axis in axes[:, 0]:
        axis.set_ylabel("heading's error (degrees)", fontsize=8)
    for axis in axes[-1]:
        axis.set_xlabel("distance (m)", fontsize=8)
    bar = figure.colorbar(image, ax=axes, shrink=0.7, pad=0.01)
    bar.set_label("success of recent episodes", fontsize=8)
    bar.ax.tick_params(labelsize=7)
    with atomic.replacing(path) as temporary:
        figure.savefig(temporary, format="png")


def _mark(axis: Axes, values: np.ndarray, solved: np.ndarray) -> None:
    """Write each open bin's success into it, and frame the solved ones."""
    from matplotlib.patches import Rectangle

    for (x, y), value in np.ndenumerate(values):
        if np.isnan(value):
            continue
        shade = "black" if value > 0.6 else "white"
        axis.text(x + 0.5, y + 0.5, f"{100 * value:.0f}", ha="center", va="center", fontsize=7, color=shade)
        if solved[x, y]:
            axis.add_patch(Rectangle((x + 0.06, y + 0.06), 0.88, 0.88, fill=False, lw=1.4, edgecolor="black"))
