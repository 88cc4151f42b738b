"""Charts as SVG: they follow the page's colors, and their numbers stand in the page as JSON beside them."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from markupsafe import Markup, escape

from skatemount.utils.formatting import format_count

WIDTH, HEIGHT = 560, 230
LEFT, RIGHT, TOP, BOTTOM = 52, 12, 10, 34
"""Size of a chart and of the room around its axes, in units of the SVG, which are pixels where it is not scaled."""

POINTS = 240
"""Most points of a line; more lines of metrics than that are averaged in equal parts of the x axis."""

COLORS = 8
"""Number of colors that the page's style has for lines, ``--s0`` to ``--s7``."""


@dataclass
class Line:
    """A line of a chart.

    Attributes:
        label: Name in the legend.
        x: ``[n]`` increasing.
        y: ``[n]``, nan where unknown.
        color: Number of its color.
        low: ``[n]`` lower edge of a band around it; None for none.
        high: ``[n]`` upper edge.
        dots: Draw a dot at every point, for few points such as evaluations.
        faint: Draw it thin and pale, and leave it out of the legend.
        dashed: Draw it dashed, such as for a reference.
    """

    label: str
    x: np.ndarray
    y: np.ndarray
    color: int = 0
    low: np.ndarray | None = None
    high: np.ndarray | None = None
    dots: bool = False
    faint: bool = False
    dashed: bool = False


@dataclass
class Chart:
    """A figure of the page.

    Attributes:
        title: Its heading.
        svg: The picture.
        data: JSON of what is drawn.
        legend: Number of the color and label of each line, empty if one line needs no legend.
        note: A sentence below.
        key: Text by which a reader can filter charts.
    """

    title: str
    svg: Markup
    data: Markup
    legend: list[tuple[int, str]] = field(default_factory=list)
    note: str = ""
    key: str = ""


def averaged(x: np.ndarray, y: np.ndarray, points: int = POINTS) -> tuple[np.ndarray, ...]:
    """Return a series of at most so many points, each the mean of a part of the x axis, and the range within it.

    Args:
        x: ``[n]`` increasing.
        y: ``[n]``; entries that are not finite are left out.
        points: Number of points.

    Returns:
        x, mean, least and greatest y of each part that has values.
    """
    known = np.isfinite(y) & np.isfinite(x)
    x, y = x[known], y[known]
    if len(x) <= points:
        return x, y, y, y
    edges = np.linspace(x[0], x[-1], points + 1)
    part = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, points - 1)
    filled, start = np.unique(part, return_index=True)
    counts = np.diff(np.append(start, len(x)))
    means = [np.add.reduceat(each, start) / counts for each in (x, y)]
    del filled
    return means[0], means[1], np.minimum.reduceat(y, start), np.maximum.reduceat(y, start)


def line_of(label: str, x: np.ndarray, y: np.ndarray | None, color: int = 0) -> Line | None:
    """Return the line of a metric: its mean, with a band of its range where values were averaged; None without any.

    Few and sparse values, such as evaluations between many iterations, get dots.
    """
    if y is None or not np.isfinite(y).any():
        return None
    known = int(np.isfinite(y).sum())
    middle, mean, low, high = averaged(x, y)
    few = known <= 40
    banded = len(middle) < known
    return Line(label, middle, mean, color, low if banded else None, high if banded else None, dots=few)


def line_chart(
    title: str,
    lines: Sequence[Line | None],
    *,
    limits: tuple[float, float] | None = None,
    x_label: str = "environment steps",
    y_format: Callable[[float], str] | None = None,
    x_format: Callable[[float], str] | None = None,
    log: bool = False,
    marks: Sequence[tuple[float, str]] = (),
    note: str = "",
    height: int = HEIGHT,
) -> Chart | None:
    """Draw lines over one x axis.

    Args:
        title: Heading of the figure.
        lines: The lines; those that are None are left out.
        limits: Ends of the y axis; None takes those of the lines.
        x_label: Name of the x axis.
        y_format: Text of a tick of the y axis.
        x_format: Text of a tick of the x axis; None writes a count.
        log: Whether the y axis is logarithmic; values that are not above 0 are left out.
        marks: Places on the x axis with a vertical rule, and their names, such as the starts of stages.
        note: A sentence below the figure.
        height: Height of the picture.

    Returns:
        The figure; None without any line.
    """
    drawn = [line for line in lines if line is not None and np.isfinite(line.y).any()]
    if log:
        drawn = [line for line in drawn if (line.y[np.isfinite(line.y)] > 0).any()]
    if not drawn:
        return None
    x_low = min(float(line.x.min()) for line in drawn)
    x_high = max(float(line.x.max()) for line in drawn)
    x_low = 0.0 if x_low > 0 and (x_low < 0.2 * x_high or x_low == x_high) else x_low
    x_high = x_high if x_high > x_low else x_low + 1.0
    low, high = limits if limits is not None else _limits(drawn, log)
    ticks = _log_ticks(low, high) if log else _ticks(low, high)
    text = y_format or (_plain_log if log else _tick_text(ticks))

    def px(value: float) -> float:
        return LEFT + (value - x_low) / (x_high - x_low) * (WIDTH - LEFT - RIGHT)

    def py(value: float) -> float:
        if log:
            share = (math.log(value) - math.log(low)) / (math.log(high) - math.log(low))
        else:
            share = (value - low) / (high - low)
        return height - BOTTOM - min(max(share, -0.02), 1.02) * (height - TOP - BOTTOM)

    parts = [_open(WIDTH, height, title)]
    for tick in ticks:
        parts.append(f'<line class="grid" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{py(tick):.1f}" y2="{py(tick):.1f}"/>')
        parts.append(f'<text class="tick" x="{LEFT - 6}" y="{py(tick) + 4:.1f}" text-anchor="end">{text(tick)}</text>')
    for tick in _ticks(x_low, x_high, 6):
        parts.append(
            f'<text class="tick" x="{px(tick):.1f}" y="{height - BOTTOM + 15}" text-anchor="middle">'
            f"{(x_format or _count)(tick)}</text>"
        )
    middle = (LEFT + WIDTH - RIGHT) / 2
    parts.append(f'<text class="axis" x="{middle}" y="{height - 4}" text-anchor="middle">{escape(x_label)}</text>')
    for place, name in marks:
        if x_low <= place <= x_high:
            parts.append(f'<line class="mark" x1="{px(place):.1f}" x2="{px(place):.1f}" y1="{TOP}" '
                         f'y2="{height - BOTTOM}"/>')  # fmt: skip
            parts.append(f'<text class="markname" x="{px(place) + 3:.1f}" y="{TOP + 9}">{escape(name)}</text>')
    for line in drawn:
        parts += _drawn_line(line, px, py, log)
    axes = {"x": [x_low, x_high], "y": [low, high], "log": log, "box": [LEFT, TOP, WIDTH - RIGHT, height - BOTTOM]}
    legend = [(line.color, line.label) for line in drawn if line.label and not line.faint]
    data = {
        "title": title,
        "axes": axes,
        "lines": [
            {"label": line.label, "color": line.color % COLORS, "faint": line.faint}
            | {"x": _numbers(line.x), "y": _numbers(line.y)}
            for line in drawn
        ],
    }
    single = len(legend) == 1 and legend[0][1] in ("", title)
    return Chart(title, Markup("".join([*parts, "</svg>"])), _json(data), [] if single else legend, note)


@dataclass
class Interval:
    """A row of a chart of intervals.

    Attributes:
        label: Name on its left.
        values: For each series its value, lower and upper end; None where there is none.
    """

    label: str
    values: list[tuple[float, float, float] | None]


def interval_chart(
    title: str, rows: Sequence[Interval], series: Sequence[str], *, note: str = "", mark: float | None = None
) -> Chart | None:
    """Draw success rates with their intervals, one row each, from 0 to 100 %.

    Args:
        title: Heading of the figure.
        rows: The rows from top to bottom.
        series: Names of the series; each has a color.
        note: A sentence below the figure.
        mark: A rate with a vertical rule.

    Returns:
        The figure; None without any value.
    """
    rows = [row for row in rows if any(value is not None for value in row.values)]
    if not rows:
        return None
    step = 12 + 14 * max(1, len(series))
    left = min(210, 30 + 7 * max(len(row.label) for row in rows))
    height = TOP + step * len(rows) + BOTTOM - 8
    right = WIDTH - 56

    def px(rate: float) -> float:
        return left + rate * (right - left)

    parts = [_open(WIDTH, height, title)]
    for tick in (0, 0.25, 0.5, 0.75, 1):
        x = px(tick)
        parts.append(f'<line class="grid" x1="{x:.1f}" x2="{x:.1f}" y1="{TOP}" y2="{height - BOTTOM + 8}"/>')
        parts.append(f'<text class="tick" x="{x:.1f}" y="{height - 10}" text-anchor="middle">{tick:.0%}</text>')
    if mark is not None:
        parts.append(f'<line class="mark" x1="{px(mark):.1f}" x2="{px(mark):.1f}" y1="{TOP}" '
                     f'y2="{height - BOTTOM + 8}"/>')  # fmt: skip
    for i, row in enumerate(rows):
        middle = TOP + step * (i + 0.5)
        name = row.label if len(row.label) <= 28 else row.label[:27] + "…"
        parts.append(f'<text class="rowname" x="{left - 10}" y="{middle + 4:.1f}" text-anchor="end">'
                     f"{escape(name)}</text>")  # fmt: skip
        for j, value in enumerate(row.values):
            if value is None:
                continue
            y = middle + 14 * (j - (len(row.values) - 1) / 2)
            color = f"var(--s{j % COLORS})"
            parts.append(f'<line stroke="{color}" stroke-width="5" stroke-linecap="round" opacity=".35" '
                         f'x1="{px(value[1]):.1f}" x2="{px(value[2]):.1f}" y1="{y:.1f}" y2="{y:.1f}"/>')  # fmt: skip
            parts.append(f'<circle fill="{color}" cx="{px(value[0]):.1f}" cy="{y:.1f}" r="4"/>')
            parts.append(f'<text class="tick" x="{right + 10}" y="{y + 4:.1f}">{value[0]:.1%}</text>')
    legend = [(j, name) for j, name in enumerate(series)] if len(series) > 1 else []
    data = {"title": title, "series": list(series), "rows": [{"label": r.label, "values": r.values} for r in rows]}
    return Chart(title, Markup("".join([*parts, "</svg>"])), _json(data), legend, note)


def spark(x: np.ndarray, y: np.ndarray | None, width: int = 120, height: int = 26) -> Markup:
    """Return a small line without axes for a row of a table; an empty text without values."""
    if y is None or not np.isfinite(y).any():
        return Markup("")
    x, y, _, _ = averaged(x, y, 60)
    span_x, span_y = float(np.ptp(x)) or 1.0, float(np.ptp(y)) or 1.0
    points = " ".join(
        f"{2 + (a - x[0]) / span_x * (width - 4):.1f},{height - 3 - (b - y.min()) / span_y * (height - 6):.1f}"
        for a, b in zip(x, y)
    )
    return Markup(f'<svg class="spark" viewBox="0 0 {width} {height}" width="{width}" height="{height}">'
                  f'<polyline points="{points}"/></svg>')  # fmt: skip


def _open(width: int, height: int, title: str) -> str:
    return f'<svg viewBox="0 0 {width} {height}" role="img" aria-label="{escape(title)}">'


def _drawn_line(line: Line, px: Callable[[float], float], py: Callable[[float], float], log: bool) -> list[str]:
    """Return the elements of a line: band, polyline, dots."""
    known = np.isfinite(line.y) & ((line.y > 0) | (not log))
    color, parts = f"var(--s{line.color % COLORS})", []
    x, y = line.x[known], line.y[known]
    if line.low is not None and line.high is not None and not log:
        low, high = line.low[known], line.high[known]
        around = [f"{px(a):.1f},{py(b):.1f}" for a, b in itertools.chain(zip(x, high), zip(x[::-1], low[::-1]))]
        parts.append(f'<polygon fill="{color}" opacity=".16" points="{" ".join(around)}"/>')
    points = " ".join(f"{px(a):.1f},{py(b):.1f}" for a, b in zip(x, y))
    kind = "faint" if line.faint else "dashed" if line.dashed else "line"
    parts.append(f'<polyline class="{kind}" stroke="{color}" points="{points}"/>')
    if line.dots or len(x) == 1:
        parts += [f'<circle fill="{color}" cx="{px(a):.1f}" cy="{py(b):.1f}" r="2.6"/>' for a, b in zip(x, y)]
    return parts


def _limits(lines: Sequence[Line], log: bool) -> tuple[float, float]:
    """Return the ends of the y axis: the lines, and of their bands as much as the lines' own span."""
    values = np.concatenate([line.y for line in lines])
    values = values[np.isfinite(values) & ((values > 0) | (not log))]
    low, high = float(values.min()), float(values.max())
    if log:
        return low / 1.3, high * 1.3
    bands = [each[np.isfinite(each)] for line in lines for each in (line.low, line.high) if each is not None]
    span = high - low or abs(high) or 1.0
    if bands:
        band = np.concatenate(bands)
        low = min(low, max(float(band.min()), low - 0.5 * span))
        high = max(high, min(float(band.max()), high + 0.5 * span))
    margin = 0.05 * (high - low or abs(high) or 1.0)
    zero = low >= 0 and low <= 0.35 * high
    return (0.0 if zero else low - margin), high + margin


def _ticks(low: float, high: float, most: int = 6) -> list[float]:
    """Return round numbers between two ends."""
    span = high - low
    step = 10.0 ** math.floor(math.log10(span / most))
    for factor in (1, 2, 5, 10):
        if span / (step * factor) <= most:
            step *= factor
            break
    first = math.ceil(low / step - 1e-9)
    last = math.floor(high / step + 1e-9)
    return [i * step for i in range(first, last + 1)]


def _log_ticks(low: float, high: float) -> list[float]:
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    wide = math.log10(high / low) > 2
    found = [m * 10.0**p for p in powers for m in ((1,) if wide else (1, 2, 5))]
    inside = [tick for tick in found if low <= tick <= high]
    return inside if len(inside) > 1 else _ticks(low, high, 4)


def _tick_text(ticks: Sequence[float]) -> Callable[[float], str]:
    """Return a function that writes ticks with as many decimals as their step needs."""
    step = abs(ticks[1] - ticks[0]) if len(ticks) > 1 else 1.0
    digits = max(0, -math.floor(math.log10(step) + 1e-9)) if step else 2
    large = any(abs(tick) >= 10_000 for tick in ticks)
    for write in (_count if large else lambda value: f"{value + 0.0:.{digits}f}", lambda value: f"{value:.8g}"):
        texts = [write(tick) for tick in ticks]
        if len(set(texts)) == len(texts) and max(map(len, texts), default=0) <= 8:
            return write
    return lambda value: f"{value:.3g}"


def _count(value: float) -> str:
    """Return a count without decimals that say nothing, such as 2M."""
    text = format_count(value)
    number, letter = (text[:-1], text[-1]) if text[-1].isalpha() else (text, "")
    return (number.rstrip("0").rstrip(".") if "." in number else number) + letter


def _plain_log(value: float) -> str:
    return f"{value:.2g}" if value < 1e-2 or value >= 1e5 else f"{value:g}"


def _numbers(values: np.ndarray) -> list[float | None]:
    return [float(f"{value:.6g}") if math.isfinite(value) else None for value in values.tolist()]


def _json(data: object) -> Markup:
    """Return JSON that can stand inside a script element: no text in it can close the element."""
    return Markup(json.dumps(data, allow_nan=False, ensure_ascii=False).replace("<", "\\u003c"))
