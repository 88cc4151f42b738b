"""Pictures of a training's metrics."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from skatemount.envs.robots.layout import JointLayout
from skatemount.envs.tasks import Metric
from skatemount.runs import atomic
from skatemount.runs.metrics import STEP, read_metrics
from skatemount.utils.errors import ConfigError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLORS = ("#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd", "#8c564b", "#e377c2", "#7f7f7f")
TRAINING, EVALUATION, SECOND = "#1f77b4", "#d62728", "#2ca02c"

Panel = tuple[str, tuple[tuple[str, str, str], ...], tuple[float, float] | None]
"""Title, (metric, color, label) of each line, limits of the y axis."""

_FIRST: tuple[Panel, ...] = (
    (
        "success rate",
        (("Success/rate", TRAINING, "training"), ("Evaluation/success", EVALUATION, "evaluated")),
        (-0.03, 1.03),
    ),
    ("mean reward of an episode", (("Train/mean_reward", TRAINING, ""),), None),
    ("episode length (control steps)", (("Train/mean_episode_length", TRAINING, ""),), None),
)
_LAST: tuple[Panel, ...] = (
    ("KL divergence and learning rate", (("Loss/kl", TRAINING, "KL"),), None),
    ("environment steps per second", (("Perf/total_fps", TRAINING, ""),), None),
)


def _panel_of(metric: Metric, layout: JointLayout | None) -> Panel:
    """Return the panel of a task's metric, with limits if the robot's layout says how large it can get."""
    names = ((f"Success/{metric.name}", TRAINING, "training"), (f"Evaluation/{metric.name}", EVALUATION, "evaluated"))
    title = metric.label + (f" ({metric.unit})" if metric.unit else "")
    if metric.most is None or layout is None:
        return title, names, None
    most = metric.most(layout)
    return title, names, (-0.025 * most, 1.025 * most)


def plot_learning_curves(
    metrics_path: Path,
    png_path: Path,
    title: str = "",
    metrics: Sequence[Metric] = (),
    layout: JointLayout | None = None,
) -> None:
    """Draw the learning curves of a run.

    The x axis is environment steps; the upper one, on the first row, is time if the metrics have it. Thin lines are the
    values, thick ones their running mean.

    Args:
        metrics_path: The run's metrics, see `read_metrics`.
        png_path: The picture, replaced in one step.
        title: The picture's title.
        metrics: The task's metrics that get a panel each.
        layout: The robot's layout, for the limits of these panels.

    Raises:
        ConfigError: The file is missing, holds something else, or has no rows.
    """
    # The object interface: no global figure list, no display, safe beside a user's own plots.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import EngFormatter, MaxNLocator

    table = read_metrics(metrics_path)
    frames = table[STEP]
    if not len(frames):
        raise ConfigError(f"{metrics_path}: has no rows to plot")
    panels = [*_FIRST, *(_panel_of(metric, layout) for metric in metrics), *_LAST]
    columns = math.ceil(len(panels) / 2)
    figure = Figure(figsize=(4 * columns, 6.4), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(title, fontsize=13, parse_math=False)
    axes = figure.subplots(2, columns, sharex=True)
    span = max(float(frames.max()), 1.0)
    used = list(axes.flat)[: len(panels)]
    for axis in list(axes.flat)[len(panels) :]:
        axis.set_visible(False)
    for axis, (name, lines, limits) in zip(used, panels, strict=True):
        drawn = [_draw(axis, frames, table.get(key), color, text) for key, color, text in lines]
        axis.set_title(name, fontsize=10)
        axis.grid(alpha=0.25)
        axis.tick_params(labelsize=8)
        axis.set_xlim(0, span)
        axis.xaxis.set_major_locator(MaxNLocator(6))
        axis.xaxis.set_major_formatter(EngFormatter(sep=""))
        if limits:
            axis.set_ylim(*limits)
        if not any(drawn):
            axis.text(0.5, 0.5, "not measured", transform=axis.transAxes, ha="center", color="grey")
        elif sum(drawn) > 1:
            axis.legend(fontsize=8, loc="best", framealpha=0.6)
    for axis in axes[1]:
        axis.set_xlabel("environment steps", fontsize=9)
    divergence, speed = used[-2:]
    speed.yaxis.set_major_formatter(EngFormatter(sep=""))
    speed.set_ylim(bottom=0)
    _draw_learning_rate(divergence, frames, table.get("Loss/learning_rate"))
    if "Perf/elapsed_s" in table:
        for axis in axes[0]:
            _add_time_axis(axis, frames, table["Perf/elapsed_s"])
    with atomic.replacing(png_path) as temporary:
        figure.savefig(temporary, format="png")


def plot_chain(runs: Sequence[tuple[str, Path]], png_path: Path, title: str = "") -> None:
    """Draw success and reward of trainings that follow one another, one color each, over the sum of their steps.

    The upper x axis is time. Thick lines with dots are deterministic evaluations, thin ones the exploring policy.

    Args:
        runs: Name and metrics file of each training, in order; files that are missing or empty are left out.
        png_path: The picture, replaced in one step.
        title: The picture's title.

    Raises:
        ConfigError: No file has rows.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import EngFormatter, MaxNLocator

    tables = [(name, read_metrics(path)) for name, path in runs if path.is_file()]
    tables = [(name, table) for name, table in tables if len(table[STEP])]
    if not tables:
        raise ConfigError(f"{png_path}: there are no metrics to plot")
    figure = Figure(figsize=(9, 6.4), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(title, fontsize=13, parse_math=False)
    success, reward = figure.subplots(2, 1, sharex=True)
    steps, seconds = 0.0, 0.0
    all_steps, all_seconds = [], []
    for i, (name, table) in enumerate(tables):
        color = COLORS[i % len(COLORS)]
        frames = steps + table[STEP]
        elapsed = seconds + table.get("Perf/elapsed_s", np.full(len(frames), np.nan))
        _draw(success, frames, table.get("Success/rate"), color, "", faint=True)
        known = np.isfinite(evaluated := table.get("Evaluation/success", np.full(len(frames), np.nan)))
        success.plot(frames[known], evaluated[known], color=color, lw=1.8, marker="o", ms=3, label=name)
        _draw(reward, frames, table.get("Train/mean_reward"), color, name)
        for axis in (success, reward):
            axis.axvspan(steps, frames.max(), color=color, alpha=0.06, lw=0)
        all_steps.append(frames)
        all_seconds.append(elapsed)
        steps = float(frames.max())
        seconds = float(np.nanmax(elapsed)) if np.isfinite(elapsed).any() else seconds
    success.set_title("success rate: evaluated (dots), training (faint)", fontsize=10)
    success.set_ylim(-0.03, 1.03)
    reward.set_title("mean reward of an episode (each stage has its own rewards)", fontsize=10)
    reward.set_xlabel("environment steps", fontsize=9)
    for axis in (success, reward):
        axis.grid(alpha=0.25)
        axis.tick_params(labelsize=8)
        axis.set_xlim(0, max(steps, 1.0))
        axis.xaxis.set_major_locator(MaxNLocator(8))
        axis.xaxis.set_major_formatter(EngFormatter(sep=""))
    success.legend(fontsize=8, loc="best", framealpha=0.6)
    _add_time_axis(success, np.concatenate(all_steps), np.concatenate(all_seconds))
    with atomic.replacing(png_path) as temporary:
        figure.savefig(temporary, format="png")


def _draw(
    axis: Axes, frames: np.ndarray, values: np.ndarray | None, color: str, label: str, faint: bool = False
) -> bool:
    """Draw one metric, or only its running mean if it is faint; return whether there was anything to draw."""
    known = np.zeros(0, bool) if values is None else np.isfinite(values)
    if values is None or not known.any():
        return False
    x, y = frames[known], values[known]
    if faint:
        axis.plot(x, _running_mean(y, len(y) // 40), color=color, lw=1.2, alpha=0.45, label=label or None)
        return True
    if len(x) < 40:
        axis.plot(x, y, color=color, label=label, lw=1.6, marker="o", ms=3)
        return True
    axis.plot(x, y, color=color, lw=0.7, alpha=0.35)
    axis.plot(x, _running_mean(y, len(y) // 40), color=color, lw=1.7, label=label)
    return True


def _draw_learning_rate(axis: Axes, frames: np.ndarray, rate: np.ndarray | None) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    if rate is None or not (rate > 0).any():
        return
    rate = np.where(rate > 0, rate, np.nan)
    twin = axis.twinx()
    # A schedule moves in steps; a running mean would show values that it never had.
    known = np.isfinite(rate)
    twin.step(frames[known], rate[known], color=SECOND, lw=1.2, alpha=0.7, where="post")
    twin.set_yscale("log")
    twin.set_ylim(np.nanmin(rate) / 2, np.nanmax(rate) * 2)  # room for a tick if it is constant
    twin.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    twin.yaxis.set_minor_locator(NullLocator())
    twin.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.0e}"))
    twin.set_ylabel("learning rate", color=SECOND, fontsize=8)
    twin.tick_params(labelsize=8, colors=SECOND)
    axis.set_ylabel("KL", color=TRAINING, fontsize=8)
    axis.set_zorder(twin.get_zorder() + 1)  # the KL line above the learning rate's
    axis.patch.set_visible(False)


def _running_mean(values: np.ndarray, half_width: int) -> np.ndarray:
    """Return the mean over up to `half_width` values on either side, fewer at the ends."""
    sums = np.concatenate(([0.0], np.cumsum(values)))
    index = np.arange(len(values))
    low = np.maximum(index - half_width, 0)
    high = np.minimum(index + half_width + 1, len(values))
    return (sums[high] - sums[low]) / (high - low)


def _add_time_axis(axis: Axes, frames: np.ndarray, elapsed_s: np.ndarray) -> None:
    from matplotlib.ticker import MaxNLocator

    known = np.isfinite(elapsed_s)
    if not known.any():
        return
    units = ((7200.0, 3600.0, "h"), (120.0, 60.0, "min"), (0.0, 1.0, "s"))
    unit, name = next(u[1:] for u in units if elapsed_s[known].max() >= u[0])
    # Time does not grow evenly with steps, so each tick is where the metrics reached its time.
    time = np.concatenate(([0.0], np.maximum.accumulate(elapsed_s[known]) / unit))
    steps = np.concatenate(([0.0], frames[known]))
    ticks = [t for t in MaxNLocator(5).tick_values(0.0, time[-1]) if 0.0 <= t <= time[-1]]
    top = axis.secondary_xaxis("top")
    top.set_xticks(np.interp(ticks, time, steps), [f"{t:g} {name}" for t in ticks])
    top.tick_params(labelsize=7, length=2, colors="grey")
