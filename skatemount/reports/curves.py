"""Learning curves of trainings, one chart for each metric, with one color for each run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from skatemount.envs.tasks import TASKS
from skatemount.reports.charts import Chart, Line, line_chart, line_of, spark
from skatemount.reports.subjects import Stage, last_mean

REWARD, TERMINATION = "Episode_Reward/", "Episode_Termination/"


@dataclass(frozen=True)
class Panel:
    """A chart of a training.

    Attributes:
        title: Heading.
        metrics: Names of the metrics.
        labels: Their names in the legend.
        limits: Ends of the y axis; None for those of the values.
        percent: Whether the values are shares.
        log: Whether the y axis is logarithmic.
        of_several: Place in `metrics` of the one that is drawn for each of several runs, if all have it.
    """

    title: str
    metrics: tuple[str, ...]
    labels: tuple[str, ...] = ("",)
    limits: tuple[float, float] | None = None
    percent: bool = False
    log: bool = False
    of_several: int = 0


TRAINED = ("training", "evaluated")
SUCCESS = Panel("success rate", ("Success/rate", "Evaluation/success"), TRAINED, (0.0, 1.02), True, of_several=1)

LEARNING = (
    SUCCESS,
    Panel("reward of an episode", ("Train/mean_reward",)),
    Panel("length of an episode, control steps", ("Train/mean_episode_length",)),
)
"""Panels that come first."""

UPDATES = (
    Panel("KL divergence of an update", ("Loss/kl",)),
    Panel("learning rate", ("Loss/learning_rate",), log=True),
    Panel("standard deviation of the actions", ("Policy/mean_std",)),
    Panel("entropy", ("Loss/entropy",)),
    Panel("loss of the critic", ("Loss/value_function",)),
    Panel("share of clipped samples", ("Loss/clip_fraction",), percent=True),
)
CURRICULUM = (
    Panel(
        "start bins", ("Curriculum/bins_open", "Curriculum/bins_solved"), ("open", "solved"), (0.0, 1.02), percent=True
    ),
    Panel(
        "farthest start that is practiced, m", ("Curriculum/frontier_free", "Curriculum/frontier_fixed"),
        ("free board", "fixed board"),
    ),
    Panel(
        "success by board", ("Curriculum/success_free", "Curriculum/success_fixed"), ("free board", "fixed board"),
        (0.0, 1.02), True,
    ),
)  # fmt: skip
SPEED = (Panel("environment steps a second", ("Perf/total_fps",)),)


def percent(value: float) -> str:
    """Return a share as a whole percentage."""
    return f"{value:.0%}"


def panel_chart(panel: Panel, stages: Mapping[str, Stage], marks: Sequence[tuple[float, str]] = ()) -> Chart | None:
    """Return a panel's chart of one training or of several.

    Args:
        panel: The panel.
        stages: The trainings by the name of their run. Of several runs one metric is drawn, one that all have.
        marks: Steps with a vertical rule, and their names.
    """
    lines: list[Line | None] = []
    if len(stages) == 1:
        (stage,) = stages.values()
        for i, (name, label) in enumerate(zip(panel.metrics, panel.labels)):
            lines.append(line_of(label, stage.steps, stage.table.get(name), i))
        y_format = percent if panel.percent else None
        return line_chart(panel.title, lines, limits=panel.limits, log=panel.log, y_format=y_format, marks=marks)
    order = [panel.of_several, *range(len(panel.metrics))]
    chosen = next((i for i in order if all(_has(stage, panel.metrics[i]) for stage in stages.values())), order[0])
    for i, (name, stage) in enumerate(stages.items()):
        lines.append(line_of(name, stage.steps, stage.table.get(panel.metrics[chosen]), i))
    title = panel.title if len(panel.metrics) == 1 else f"{panel.title}, {panel.labels[chosen]}"
    return line_chart(
        title, lines, limits=panel.limits, log=panel.log, y_format=percent if panel.percent else None
    )  # fmt: skip


def task_panels(stages: Sequence[Stage]) -> list[Panel]:
    """Return a panel for each metric of a task that the trainings logged, with the task's label and unit."""
    known = {metric.name: metric for name in TASKS.names() for metric in TASKS.get(name).metrics}
    logged = dict.fromkeys(
        name.partition("/")[2]
        for stage in stages
        for name in stage.table
        if name.startswith(("Success/", "Evaluation/")) and name not in SUCCESS.metrics
    )
    found = []
    for name in logged:
        metric = known.get(name)
        title = name.replace("_", " ") if metric is None else metric.label
        if metric is not None and metric.unit:
            title += f", {metric.unit}"
        found.append(Panel(title, (f"Success/{name}", f"Evaluation/{name}"), TRAINED, of_several=1))
    return found


def charts(panels: Sequence[Panel], stages: Mapping[str, Stage]) -> list[Chart]:
    """Return the charts of those panels that have values."""
    found = (panel_chart(panel, stages) for panel in panels)
    return [chart for chart in found if chart is not None]


def prefixed(prefix: str, stages: Mapping[str, Stage], y_format: Callable[[float], str] | None = None) -> list[Chart]:
    """Return a chart for each metric whose name begins with a prefix, titled with the rest of its name."""
    names = dict.fromkeys(name for stage in stages.values() for name in stage.table if name.startswith(prefix))
    found = []
    for name in names:
        lines = [
            line_of(run if len(stages) > 1 else "", stage.steps, stage.table.get(name), i)
            for i, (run, stage) in enumerate(stages.items())
        ]
        title = name.removeprefix(prefix)
        if (chart := line_chart(title, lines, y_format=y_format, height=180)) is not None:
            chart.key = title
            found.append(chart)
    return found


@dataclass
class Term:
    """A reward term in a table.

    Attributes:
        name: Its name.
        weight: Its weight in the settings, as text.
        final: For each run its mean over the last tenth of the training; None if it was not logged.
        share: Size of the first run's value as a part of the largest one, 0 to 1.
        spark: Small curve of the first run.
    """

    name: str
    weight: str
    final: list[float | None]
    share: float
    spark: Markup


def terms(stages: Mapping[str, Stage], prefix: str = REWARD, group: str = "reward") -> list[Term]:
    """Return the reward terms of trainings, the largest first.

    Args:
        stages: The trainings by the name of their run.
        prefix: Prefix of the metrics.
        group: Group of the settings that has their weights.
    """
    first = next(iter(stages.values()))
    names = dict.fromkeys(name for stage in stages.values() for name in stage.table if name.startswith(prefix))
    found = []
    for name in names:
        short = name.removeprefix(prefix)
        row = (first.config.get(group) or {}).get(short)
        weight = row.get("weight") if isinstance(row, dict) else None
        final = [_last(stage.table.get(name)) for stage in stages.values()]
        found.append(Term(short, "" if weight is None else f"{weight:g}", final, 0.0,
                          spark(first.steps, first.table.get(name))))  # fmt: skip
    largest = max((abs(term.final[0] or 0.0) for term in found), default=0.0) or 1.0
    for term in found:
        term.share = abs(term.final[0] or 0.0) / largest
    return sorted(found, key=lambda term: -term.share)


def others(stages: Mapping[str, Stage], shown: Sequence[Panel]) -> list[Chart]:
    """Return the charts of all metrics that no panel shows, under their full names."""
    known = {name for panel in shown for name in panel.metrics}
    names = dict.fromkeys(name for stage in stages.values() for name in stage.table)
    left = [n for n in names if n not in known and n != "frames" and not n.startswith((REWARD, TERMINATION, "Perf/"))]
    return charts([Panel(name, (name,)) for name in left], stages)


def _has(stage: Stage, name: str) -> bool:
    values = stage.table.get(name)
    return values is not None and bool(np.isfinite(values).any())


def _last(values: np.ndarray | None) -> float | None:
    return None if values is None or not np.isfinite(values).any() else last_mean(values)
