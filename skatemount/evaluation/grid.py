"""Grids: suites whose variants are all pairs of steps of two quantities."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skatemount.runs import atomic
from skatemount.utils.tables import new_table, rendered

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from skatemount.evaluation.results import Evaluation

SUCCESS = "success rate"


@dataclass(frozen=True)
class Layer:
    """One value in every cell of a grid.

    Attributes:
        label: Name of the value.
        digits: Decimals of the value in texts.
        values: ``[rows][columns]``; None for a cell without any value.
    """

    label: str
    digits: int
    values: tuple[tuple[float | None, ...], ...]


@dataclass(frozen=True)
class Grid:
    """Results over two quantities.

    Attributes:
        across: Name of the quantity of the columns.
        down: Name of the quantity of the rows.
        columns: Names of the steps of the first.
        rows: Names of the steps of the second.
        layers: The success rate, then the metrics in which the task is summed up, by their names.
    """

    across: str
    down: str
    columns: tuple[str, ...]
    rows: tuple[str, ...]
    layers: dict[str, Layer]

    @classmethod
    def of(cls, result: Evaluation) -> Grid | None:
        """Return the grid of a suite's results; None if its variants are none.

        Args:
            result: The evaluation of one suite.
        """
        definition = result.evaluated.get("definition") or {}
        if not (quantities := definition.get("grid")) or not result.variants:
            return None
        (across, columns), (down, rows) = quantities.items()
        parts = result.by_variant()
        cells = {(row, column): parts.get(f"{column}, {row}") for row, column in itertools.product(rows, columns)}

        def layer(label: str, digits: int, value: Any) -> Layer:
            found = {place: None if part is None else value(part) for place, part in cells.items()}
            return Layer(label, digits, tuple(tuple(found[row, column] for column in columns) for row in rows))

        layers = {"success": layer(SUCCESS, 2, lambda part: part.success_rate)}
        for metric in result.task.metrics_of(result.task.overview):
            label = metric.label + (f", {metric.unit}" if metric.unit else "")
            name = metric.name
            layers[name] = layer(label, metric.digits, lambda part, name=name: part.number(name))
        return cls(across, down, tuple(columns), tuple(rows), layers)

    def to_dict(self) -> dict[str, Any]:
        """Return the grid as plain values for JSON: a list of rows for each value, from left to right."""
        values = {name: [list(row) for row in layer.values] for name, layer in self.layers.items()}
        return {
            "across": {"quantity": self.across, "steps": list(self.columns)},
            "down": {"quantity": self.down, "steps": list(self.rows)},
            "values": values,
        }

    def table(self) -> str:
        """Return a table for the success rate, and one for the first metric."""
        texts = []
        for layer in list(self.layers.values())[:2]:
            made = new_table(f"{layer.label}: {self.down} \\ {self.across}", *self.columns)
            for name, row in zip(self.rows, layer.values, strict=True):
                made.add_row(name, *("-" if value is None else f"{value:.{layer.digits}f}" for value in row))
            texts.append(rendered(made))
        return "\n\n".join(texts)


def plot_grid(grid: Grid, title: str, png_path: Path) -> None:
    """Draw heat maps of the success rate and of the first metric, and curves of the metric over the first quantity.

    Args:
        grid: The grid.
        title: Title of the figure.
        png_path: The picture (PNG), replaced in one step.
    """
    # The object interface has no global list of figures and needs no display.
    from matplotlib.figure import Figure

    shown = list(grid.layers.values())[:2]
    panels = len(shown) + (len(shown) > 1)
    figure = Figure(figsize=(4.6 * panels, 3.8), dpi=110, layout="constrained")
    figure.suptitle(title, fontsize=11, parse_math=False)
    axes = figure.subplots(1, panels, squeeze=False)[0]
    for axis, layer in zip(axes, shown, strict=False):
        _draw_cells(axis, grid, layer)
    if len(shown) > 1:
        _draw_curves(axes[-1], grid, shown[-1])
    with atomic.replacing(png_path) as temporary:
        figure.savefig(temporary, format="png")


def _draw_cells(axis: Axes, grid: Grid, layer: Layer) -> None:
    """Draw one value of every cell as a color and a number."""
    numbers = [[math.nan if value is None else value for value in row] for row in layer.values]
    rate = layer.label == SUCCESS
    known = [value for row in numbers for value in row if math.isfinite(value)]
    low, high = (0.0, 1.0) if rate else (min(known, default=0.0), max(known, default=1.0))
    axis.imshow(numbers, cmap="viridis" if rate else "viridis_r", vmin=low, vmax=high, aspect="auto", origin="lower")
    dark_above = not rate
    for (y, row), x in itertools.product(enumerate(numbers), range(len(grid.columns))):
        if not math.isfinite(row[x]):
            continue
        share = (row[x] - low) / (high - low) if high > low else 0.0
        color = "white" if (share > 0.5) == dark_above else "black"
        axis.text(x, y, f"{row[x]:.{layer.digits}f}", ha="center", va="center", fontsize=7, color=color)
    axis.set_xticks(range(len(grid.columns)), grid.columns)
    axis.set_yticks(range(len(grid.rows)), grid.rows)
    axis.set_xlabel(grid.across, fontsize=9)
    axis.set_ylabel(grid.down, fontsize=9)
    axis.set_title(layer.label, fontsize=10)
    axis.tick_params(labelsize=8)


def _draw_curves(axis: Axes, grid: Grid, layer: Layer) -> None:
    """Draw a value over the columns, a line for each row."""
    for name, row in zip(grid.rows, layer.values, strict=True):
        values = [math.nan if value is None else value for value in row]
        axis.plot(range(len(values)), values, marker="o", ms=3, lw=1.2, label=name)
    axis.set_xticks(range(len(grid.columns)), grid.columns)
    axis.set_ylim(bottom=0)
    axis.set_xlabel(grid.across, fontsize=9)
    axis.set_title(layer.label, fontsize=10)
    axis.legend(title=grid.down, fontsize=7, title_fontsize=7)
    axis.tick_params(labelsize=8)
    axis.grid(alpha=0.25)
