"""A heat map of a grid of bins of initial states: the open bins and their success rates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from torch import Tensor

from skatemount.runs import atomic

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_BOARDS = ("fixed board", "free board")


def draw_heat_map(
    path: Path,
    title: str,
    axes: Sequence[str],
    rates: Tensor,
    opened: Tensor,
    solved: Tensor,
    resting: Tensor,
    edges: Mapping[str, Sequence[float]],
) -> None:
    """Draw success over distance and heading, for fixed and free boards and each height of the step.

    Bins that are not open are blank. A solved bin has a black frame. A resting bin, from which no start is drawn any
    more, is hatched, because its estimate is old. The number in a bin is its success rate in percent. Other axes of the
    grid are averaged over their open bins; a bin is then solved or resting if all of these are.

    Args:
        path: The picture (PNG), replaced in one step.
        title: Title of the figure.
        axes: Names of the grid's axes, ``distance``, ``heading``, ``height`` and ``free`` among them.
        rates: The grid of estimated success rates.
        opened: The grid of open bins, bool.
        solved: The grid of solved bins, bool.
        resting: The grid of resting bins, bool.
        edges: Upper edges of the bins along ``distance`` (m), ``heading`` (degrees) and ``height`` (m).
    """
    # The object interface has no global list of figures and needs no display.
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    shown = [list(axes).index(name) for name in ("distance", "heading", "height", "free")]
    others = [i for i in range(len(axes)) if i not in shown]

    def grid(values: Tensor) -> np.ndarray:
        """Return values as ``[distance, heading, height, free, others]``."""
        return values.cpu().permute(*shown, *others).reshape(*(values.shape[i] for i in shown), -1).numpy()

    is_open = grid(opened)
    count = is_open.sum(-1)
    success = np.where(count > 0, (grid(rates) * is_open).sum(-1) / np.maximum(count, 1), np.nan)
    is_solved, is_resting = ((count > 0) & (grid(each) | ~is_open).all(-1) for each in (solved, resting))

    distances, headings, heights = edges["distance"], edges["heading"], edges["height"]
    columns = len(heights)
    boards = _BOARDS[: success.shape[-1]]
    figure = Figure(figsize=(1.5 + 3.6 * columns, 2.8 * len(boards)), dpi=100, layout="constrained")

    figure.suptitle(title, fontsize=12, parse_math=False)
    panels = figure.subplots(len(boards), columns, squeeze=False, sharex=True, sharey=True)
    colors = Normalize(0.0, 1.0)
    for column, high in enumerate(heights):
        name = f"step up to {1000 * high:.0f} mm" if column < columns - 1 else "full height"
        for row, board in enumerate(boards):
            axis = panels[row, column]
            values = success[:, :, column, row]
            image = axis.pcolormesh(values.T, cmap="viridis", norm=colors, edgecolors="white", linewidth=0.5)
            _mark(axis, values, is_solved[:, :, column, row], is_resting[:, :, column, row])
            axis.set_title(f"{board}, {name}", fontsize=9)
    for axis in panels.flat:
        axis.set_xticks(range(len(distances) + 1), [f"{d:g}" for d in (0.0, *distances)], fontsize=7)
        axis.set_yticks(range(len(headings) + 1), [f"{h:g}" for h in (0.0, *headings)], fontsize=7)
    for axis in panels[:, 0]:
        axis.set_ylabel("heading's error (degrees)", fontsize=8)
    for axis in panels[-1]:
        axis.set_xlabel("distance (m)", fontsize=8)
    bar = figure.colorbar(image, ax=panels, shrink=0.7, pad=0.01)
    bar.set_label("success of recent episodes", fontsize=8)
    bar.ax.tick_params(labelsize=7)
    with atomic.replacing(path) as temporary:
        figure.savefig(temporary, format="png")


def _mark(axis: Axes, values: np.ndarray, solved: np.ndarray, resting: np.ndarray) -> None:
    """Write each open bin's success into it, frame the solved ones, hatch the resting ones."""
    from matplotlib.patches import Rectangle

    for (x, y), value in np.ndenumerate(values):
        if np.isnan(value):
            continue
        shade = "black" if value > 0.6 else "white"
        axis.text(x + 0.5, y + 0.5, f"{100 * value:.0f}", ha="center", va="center", fontsize=7, color=shade)
        if resting[x, y]:
            axis.add_patch(Rectangle((x, y), 1, 1, fill=False, lw=0, hatch="///", edgecolor="0.45"))
        if solved[x, y]:
            axis.add_patch(Rectangle((x + 0.06, y + 0.06), 0.88, 0.88, fill=False, lw=1.4, edgecolor="black"))
