"""A success map: the success rate over the robot's initial position and heading."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from skatemount.envs.config.board import SkateboardConfig
from skatemount.evaluation.intervals import wilson_interval
from skatemount.evaluation.results import Evaluation
from skatemount.runs import atomic

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import QuadMesh

FAILURE, BARS, EDGE = "#d62728", "#4c78a8", "#333333"
_EPISODES_PER_CELL = 12
_SECTORS = (24, 12, 8)
_EPISODES_PER_SECTOR = 20


def plot_success_map(result: Evaluation, boards: Sequence[SkateboardConfig], png_path: Path) -> None:
    """Draw the success rate over the initial pose.

    The left panel shows it over the trunk's position in the board's frame, in square cells of about a dozen episodes
    each, with a dot for each failed episode and the outline of the deck. Cells in which no episode began are blank. The
    right panel shows it over the heading, with Wilson's 95 % intervals.

    Args:
        result: The evaluation.
        boards: The boards of the evaluation, for their outlines.
        png_path: The picture (PNG), replaced in one step.
    """
    # The object interface has no global list of figures and needs no display.
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 5.8), dpi=110, layout="constrained")
    low, high = result.interval
    rate = f"{result.success_rate:.1%} of {result.episodes:,} episodes (95 % interval {low:.1%} to {high:.1%})"
    figure.suptitle(f"{result.title}: {rate}", fontsize=13, parse_math=False)
    width, height = np.ptp(_limits(result, boards), axis=0)
    place, heading = figure.subplots(1, 2, width_ratios=(1.15 * float(np.clip(width / height, 0.45, 1)), 1))
    mesh = _draw_places(place, result, boards)
    figure.colorbar(mesh, ax=place, label="success rate", fraction=0.046, pad=0.02)
    _draw_headings(heading, result)
    with atomic.replacing(png_path) as temporary:
        figure.savefig(temporary, format="png")


def rates_by_place(xy: np.ndarray, success: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return success rates in nearly square cells, of about a dozen episodes each if positions fill the rectangle.

    Args:
        xy: ``[N, 2]`` initial positions, m.
        success: ``[N]`` bool.

    Returns:
        The edges of the cells along x and along y, m, and ``[cells along x, cells along y]`` rates, nan in empty cells.
    """
    low, high = xy.min(0) - 1e-6, xy.max(0) + 1e-6
    span = high - low
    cell = np.sqrt(span.prod() * _EPISODES_PER_CELL / len(xy))
    counts = np.clip(np.round(span / np.clip(cell, span.max() / 40, span.max() / 4)), 1, None).astype(int)
    edges = [np.linspace(low[i], high[i], counts[i] + 1) for i in range(2)]
    index = tuple(np.clip(np.digitize(xy[:, i], edges[i]) - 1, 0, counts[i] - 1) for i in range(2))
    episodes, successes = np.zeros(counts), np.zeros(counts)
    np.add.at(episodes, index, 1)
    np.add.at(successes, index, success)
    with np.errstate(invalid="ignore"):
        return edges[0], edges[1], successes / episodes


def _draw_places(axis: Axes, result: Evaluation, boards: Sequence[SkateboardConfig]) -> QuadMesh:
    records = result.records
    xy, success = records.start[:, :2].double().numpy(), records.success.numpy()
    x, y, rates = rates_by_place(xy, success)
    mesh = axis.pcolormesh(x, y, np.ma.masked_invalid(rates.T), cmap="viridis", vmin=0, vmax=1, alpha=0.85)
    failed = xy[~success]
    # Smaller dots for many failures, or they would hide the cells.
    size = float(np.clip(4000 / max(len(failed), 1), 2, 22))
    rim = 0.3 if size > 6 else 0.0
    x_failed, y_failed = failed[:, 0], failed[:, 1]
    axis.scatter(x_failed, y_failed, s=size, c=FAILURE, edgecolors="white", linewidths=rim, zorder=3)
    for board in boards:
        _draw_board(axis, board, alpha=1.0 if len(boards) == 1 else 0.4)
    lower, upper = _limits(result, boards)
    axis.set_xlim(lower[0], upper[0])
    axis.set_ylim(lower[1], upper[1])
    dots = f"; dots: the {len(failed):,} failures" if len(failed) else ""
    axis.set_title(f"by the trunk's place at the start{dots}", fontsize=10)
    axis.set_aspect("equal")
    axis.set_xlabel("along the board, m", fontsize=9)
    axis.set_ylabel("to its left, m", fontsize=9)
    axis.tick_params(labelsize=8)
    axis.grid(alpha=0.2)
    return mesh


def _limits(result: Evaluation, boards: Sequence[SkateboardConfig]) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners of the drawn area: all starts, and the boards unless every start is above them."""
    xy = result.records.start[:, :2].double().numpy()
    lower, upper = xy.min(0), xy.max(0)
    corner = np.max([(board.deck_length / 2 + board.kick_length, board.deck_width / 2) for board in boards], axis=0)
    if (np.abs([lower, upper]) > corner).any():
        lower, upper = np.minimum(lower, -corner), np.maximum(upper, corner)
    margin = 0.05 * (upper - lower).max() + 1e-3
    return lower - margin, upper + margin


def _draw_board(axis: Axes, board: SkateboardConfig, alpha: float) -> None:
    from matplotlib.patches import Arc, Rectangle

    x, width = board.deck_length / 2, board.deck_width
    # The flat part of the deck and the rounded kicks at its ends.
    line: dict[str, Any] = dict(edgecolor=EDGE, alpha=alpha, zorder=2)
    axis.add_patch(Rectangle((-x, -width / 2), 2 * x, width, fill=False, lw=1.3, **line))
    for end, first in ((-x, 90), (x, -90)):
        arc = Arc((end, 0), 2 * board.kick_length, width, theta1=first, theta2=first + 180, lw=0.8, **line)
        axis.add_patch(arc)


def _draw_headings(axis: Axes, result: Evaluation) -> None:
    records = result.records
    degrees, success = np.degrees(records.start[:, 2].double().numpy()), records.success.numpy()
    span = np.ptp(degrees)
    sectors = next((n for n in _SECTORS if len(degrees) >= n * _EPISODES_PER_SECTOR), _SECTORS[-1])
    if span > 180:
        edges = np.linspace(-180, 180, sectors + 1)
    else:
        edges = np.linspace(degrees.min() - 1e-6, degrees.max() + 1e-6, sectors // 2 + 1)
    index = np.clip(np.digitize(degrees, edges) - 1, 0, len(edges) - 2)
    episodes = np.bincount(index, minlength=len(edges) - 1)
    successes = np.bincount(index, weights=success, minlength=len(edges) - 1)
    filled = episodes > 0
    centers, widths = ((edges[:-1] + edges[1:]) / 2)[filled], np.diff(edges)[filled]
    rates = successes[filled] / episodes[filled]
    bounds = np.array([wilson_interval(int(s), int(n)) for s, n in zip(successes[filled], episodes[filled])])
    axis.bar(centers, rates, width=0.9 * widths, color=BARS, alpha=0.85)
    whiskers = np.abs(bounds.T - rates)
    axis.errorbar(centers, rates, yerr=whiskers, fmt="none", ecolor=EDGE, elinewidth=1, capsize=2)
    axis.axhline(result.success_rate, color=EDGE, lw=0.8, ls=":")
    axis.set_xlim(edges[0], edges[-1])
    if span > 180:
        axis.set_xticks(range(-180, 181, 45))
    axis.set_ylim(0, 1.02)
    axis.set_title("by the heading at the start, with 95 % intervals", fontsize=10)
    axis.set_xlabel("degrees to the left of the board's x axis", fontsize=9)
    axis.set_ylabel("success rate", fontsize=9)
    axis.tick_params(labelsize=8)
    axis.grid(axis="y", alpha=0.25)
