"""Ladders: suites whose variants are steps of one quantity, from easy to hard."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skatemount.runs import atomic
from skatemount.utils.tables import new_table, rendered

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from skatemount.evaluation.results import Evaluation

ENOUGH = 0.90
"""Success rate below which a step counts as too hard."""

COLORS = ("#1f77b4", "#ff7f0e", "#2ca02c", "#9467bd", "#8c564b", "#e377c2")
_LIMIT = "#888888"
_PANELS = 3
"""Most panels in a row of a figure."""


@dataclass(frozen=True)
class Step:
    """A step of a ladder.

    Attributes:
        name: Name of the variant.
        episodes: Number of episodes.
        rate: Success rate.
        low: Lower end of Wilson's 95 % interval.
        high: Upper end.
    """

    name: str
    episodes: int
    rate: float
    low: float
    high: float


@dataclass(frozen=True)
class Ladder:
    """Success rates along one quantity.

    Attributes:
        quantity: Name of the quantity.
        unit: Its unit; empty if it has none.
        steps: The steps, from easy to hard.
    """

    quantity: str
    unit: str
    steps: tuple[Step, ...]

    @classmethod
    def of(cls, result: Evaluation) -> Ladder | None:
        """Return the ladder of a suite's results; None if its variants are none.

        Args:
            result: The evaluation of one suite.
        """
        definition = result.evaluated.get("definition") or {}
        if not (quantity := definition.get("ladder")) or not result.variants:
            return None
        steps = (
            Step(name, part.episodes, part.success_rate, *part.interval) for name, part in result.by_variant().items()
        )
        return cls(quantity, definition.get("unit", ""), tuple(steps))

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Ladder:
        """Return the ladder that `to_dict` wrote."""
        return cls(values["quantity"], values["unit"], tuple(Step(**step) for step in values["steps"]))

    def to_dict(self) -> dict[str, Any]:
        """Return the ladder as plain values for JSON, with the step at which it falls below `ENOUGH`, or null."""
        hard = self.falls_at
        fall = {"falls_below": ENOUGH, "falls_at": None if hard is None else hard.name}
        return {"quantity": self.quantity, "unit": self.unit, **fall, "steps": [asdict(step) for step in self.steps]}

    @property
    def falls_at(self) -> Step | None:
        """First step whose success rate is below `ENOUGH`; None if there is none."""
        return next((step for step in self.steps if step.rate < ENOUGH), None)

    @property
    def verdict(self) -> str:
        """The step at which the success rate falls below `ENOUGH`, in words."""
        hard = self.falls_at
        return f"stays above {ENOUGH:.2f}" if hard is None else f"falls below {ENOUGH:.2f} at {self.label(hard)}"

    def label(self, step: Step) -> str:
        """Return the name of a step with its unit, such as ``40ms`` or ``0.5 m/s``."""
        return step.name if not self.unit or step.name.endswith(self.unit) else f"{step.name} {self.unit}"


def table(ladders: Mapping[str, Ladder]) -> str:
    """Return the steps of several ladders as a table, with a row for each step.

    Args:
        ladders: The ladders by the name of their suite.
    """
    made = new_table("ladder", "step", "success", "95 % interval", "")
    for name, ladder in ladders.items():
        for i, step in enumerate(ladder.steps):
            interval = f"{step.low:.1%} to {step.high:.1%}"
            verdict = ladder.verdict if i == 0 else ""
            made.add_row("" if i else name, ladder.label(step), f"{step.rate:.1%}", interval, verdict)
    return rendered(made)


def plot_ladders(ladders: Mapping[str, Mapping[str, Ladder]], png_path: Path) -> None:
    """Draw success rate against step, with Wilson's 95 % intervals.

    Each suite has a panel, and each policy a line in it. Steps are evenly spaced. A dashed line marks `ENOUGH`.

    Args:
        ladders: Ladders of the policies by name, by the name of the suite.
        png_path: The picture (PNG), replaced in one step.
    """
    # The object interface has no global list of figures and needs no display.
    from matplotlib.figure import Figure

    down = math.ceil(len(ladders) / _PANELS)
    across = math.ceil(len(ladders) / down)
    figure = Figure(figsize=(4.2 * across, 3.4 * down), dpi=110, layout="constrained")
    axes = figure.subplots(down, across, squeeze=False, sharey=True).ravel()
    names = list(dict.fromkeys(name for policies in ladders.values() for name in policies))
    for axis, (suite, policies) in zip(axes, ladders.items(), strict=False):
        _draw(axis, suite, policies, names)
    for axis in axes[len(ladders) :]:
        axis.set_visible(False)
    with atomic.replacing(png_path) as temporary:
        figure.savefig(temporary, format="png")


def _draw(axis: Axes, suite: str, policies: Mapping[str, Ladder], names: list[str]) -> None:
    """Draw the panel of one suite."""
    first = next(iter(policies.values()))
    labels = [step.name for step in first.steps]
    # Intervals of several policies stand side by side.
    apart = 0.06
    for name, ladder in policies.items():
        i = names.index(name)
        x = [labels.index(step.name) + apart * (i - (len(names) - 1) / 2) for step in ladder.steps]
        rates = [step.rate for step in ladder.steps]
        below = [step.rate - step.low for step in ladder.steps]
        above = [step.high - step.rate for step in ladder.steps]
        color = COLORS[i % len(COLORS)]
        axis.errorbar(x, rates, yerr=(below, above), color=color, marker="o", ms=4, lw=1.4, capsize=3, label=name)
    axis.axhline(ENOUGH, color=_LIMIT, lw=0.9, ls="--", zorder=1)
    axis.set_xticks(range(len(labels)), labels)
    axis.set_xlim(-0.4, len(labels) - 0.6)
    axis.set_ylim(-0.03, 1.03)
    axis.yaxis.set_major_formatter("{x:.0%}")
    unit = f", {first.unit}" if first.unit and not labels[-1].endswith(first.unit) else ""
    axis.set_xlabel(f"{first.quantity}{unit}", fontsize=9)
    axis.set_ylabel("success rate", fontsize=9)
    axis.tick_params(labelsize=8, labelleft=True)
    axis.grid(alpha=0.25)
    # One policy needs no legend: its name and its verdict fit into the title.
    if len(names) == 1:
        axis.set_title(f"{names[0]} on {suite}: {first.verdict}", fontsize=9, parse_math=False)
    else:
        axis.set_title(suite, fontsize=10, parse_math=False)
        axis.legend(fontsize=8, loc="lower left")
