"""`TaskDefinition`: what an episode is about. Training, evaluation, tables, curves and films iterate over its names."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from skatemount.envs.robots.layout import JointLayout
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.tasks.measures import Measure, MeasureFunction
from skatemount.envs.tasks.reducers import REDUCERS, Reducer
from skatemount.envs.terms import TaskContext
from skatemount.utils.errors import ConfigError

COUNTS = ("all", "complete", "success")
"""Episodes that a metric has a value in: all, those that lasted until the time limit, or those that succeeded."""
OVER = ("steps", "end", "success")
"""Times at which training takes a value: the mean over an episode's steps, its end, or the end of a success."""
RESERVED = ("episodes", "success", "failures", "variants", "failed_episodes", "evaluated", "diverged", "rate")
"""Names that results use themselves."""

_NAME = re.compile(r"[a-z][a-z0-9_]*")


@dataclass(frozen=True)
class TrainingValue:
    """A value that a training logs as ``Success/<metric>``, cheap enough for every step of it.

    Attributes:
        function: Takes the episodes after a step and the constants of the task, and returns ``[N]``.
        over: One of `OVER`: ``steps`` (mean over the steps of an episode), ``end`` (value in the last step) or
            ``success`` (value in the last step of the episodes that succeeded).
    """

    function: Callable[[EpisodeState, TaskContext], Tensor]
    over: str = "end"


@dataclass(frozen=True)
class Metric:
    """A number that evaluations measure in every episode.

    Attributes:
        name: Name in JSON, logs and records, in lower case.
        label: Name in tables, curves and films.
        meaning: How it is measured, in one line, for the docs.
        measure: A function ``(sim, episode, context)`` or a subclass of `Measure`, which returns ``[N]``. It is called
            after every control step of an evaluation; the value of an episode is that of its last step.
        unit: Unit, "" for a plain number.
        reducer: One result from the values of all episodes, a key of `skatemount.envs.tasks.reducers.REDUCERS`.
        counts: Episodes that have a value, one of `COUNTS`.
        otherwise: Value of all other episodes; nan leaves them out of the result.
        digits: Decimals in texts.
        note: Words behind the value in the table of one evaluation, such as "an episode".
        most: Takes the robot's layout and returns the largest possible value, for texts ("3.9 of 4") and curves.
        training: The value of the same name that trainings log; None for none.
        of_one: The metric of one episode in words, with ``{}`` for its value; "" for the label before the value.
    """

    name: str
    label: str
    meaning: str
    measure: MeasureFunction | type[Measure]
    unit: str = ""
    reducer: str = "mean"
    counts: str = "all"
    otherwise: float = math.nan
    digits: int = 2
    note: str = ""
    most: Callable[[JointLayout], float] | None = None
    training: TrainingValue | None = None
    of_one: str = ""

    @property
    def reduce(self) -> Reducer:
        """The reducer."""
        return REDUCERS[self.reducer]

    def start(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> MeasureFunction:
        """Return a function that measures new episodes; call it once after every control step.

        Args:
            sim: ``[N]`` start states.
            episode: ``[N]`` episodes at their start.
            context: Constants of the task.
        """
        if not isinstance(self.measure, type):
            return self.measure
        measure = self.measure()
        measure.begin(sim, episode, context)
        return measure

    def short(self, value: float | None, most: float | None = None) -> str:
        """Return a value of one episode, or of a reducer, with its unit.

        Args:
            value: The value; None for none.
            most: The largest possible value, if there is one.
        """
        if value is None or not math.isfinite(value):
            return "-"
        if self.reducer == "share":
            return f"{value:.1%}"
        text = f"{value:.{self.digits}f}" + (f" {self.unit}" if self.unit else "")
        return text if most is None else f"{text} of {most:g}"

    def text(self, summary: Any, most: float | None = None) -> str:
        """Return a result of the reducer in words.

        Args:
            summary: The result.
            most: The largest possible value, if there is one.
        """
        text = self.reduce.text(summary, lambda value: self.short(value, most))
        return text if text == "-" or not self.note else f"{text} {self.note}"


@dataclass(frozen=True)
class TaskDefinition:
    """Definition of a task: criterion, failure, metrics and score of its episodes.

    Attributes:
        name: Value of the setting ``success``, in lower case.
        description: One line about the task.
        success: Criterion: a function ``(sim, episode, context)`` of the last step that returns ``[N]`` bool. An
            episode must also last until its time limit. Its docstring stands in the docs.
        failure: Name of a failure that lasted until the time limit.
        failure_words: The same in words.
        metrics: Metrics in the order of tables and JSON.
        score: Weights by metric. The checkpoint with the highest ``success rate + sum(weight * metric)`` of its
            evaluation is the best one.
        overview: Names of the metrics in tables with one row for each evaluation, and in the texts of films.
        progress: Names of the metrics that the progress display and the learning curves of a training show.
        state_word: Word on the pictures of a film while `in_state` is true; "" for none.
        in_state: A function ``(sim, episode, context)`` that returns ``[N]`` bool; None for none.
        uses_command: True if success depends on the velocity command, so that an evaluation always gives it.
        start_curricula: True if curricula may choose the start states, around the board.
    """

    name: str
    description: str
    success: MeasureFunction
    failure: str
    failure_words: str
    metrics: tuple[Metric, ...] = ()
    score: Mapping[str, float] = field(default_factory=dict)
    overview: tuple[str, ...] = ()
    progress: tuple[str, ...] = ()
    state_word: str = ""
    in_state: MeasureFunction | None = None
    uses_command: bool = False
    start_curricula: bool = True

    def __post_init__(self) -> None:
        """Raise `ConfigError` for a definition that cannot be used."""
        where = f"task {self.name!r}"
        _check_name(where, "name", self.name)
        _check_name(where, "failure", self.failure)
        if not callable(self.success):
            raise ConfigError(f"{where}: success={self.success!r} must be a function of sim, episode and context")
        known: list[str] = []
        for metric in self.metrics:
            _check_metric(f"{where}, metric {metric.name!r}", metric)
            if metric.name in known:
                raise ConfigError(f"{where}: two metrics have the name {metric.name!r}")
            known.append(metric.name)
        for name, weight in self.score.items():
            if isinstance(weight, bool) or not isinstance(weight, int | float) or not math.isfinite(weight):
                raise ConfigError(f"{where}: score of {name}={weight!r} must be a finite number")
        for what, names in (("score", self.score), ("overview", self.overview), ("progress", self.progress)):
            for name in names:
                _check_choice(f"{where}: {what}", name, known, "metric of it")

    def succeeded(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
        """Return the worlds whose episode meets the criterion if it ends now, ``[N]`` bool.

        Args:
            sim: The state after a step.
            episode: The episodes after the step.
            context: Constants of the task.

        Raises:
            ConfigError: The criterion returned something else.
        """
        return checked_flags(self.success(sim, episode, context), f"task {self.name!r}: success", episode)

    def score_of(self, metrics: Mapping[str, float]) -> float | None:
        """Return the score of a checkpoint, by which the best one is chosen; None if it was not evaluated.

        Args:
            metrics: Metrics of a training, with ``Evaluation/*`` if it was evaluated.
        """
        if "Evaluation/success" not in metrics:
            return None
        named = ((weight, f"Evaluation/{name}") for name, weight in self.score.items())
        return metrics["Evaluation/success"] + sum(weight * metrics[key] for weight, key in named if key in metrics)

    def most(self, layout: JointLayout) -> dict[str, float]:
        """Return the largest possible value of each metric that has one, for a robot."""
        return {metric.name: metric.most(layout) for metric in self.metrics if metric.most is not None}

    def metrics_of(self, names: Collection[str]) -> list[Metric]:
        """Return the metrics with these names, in the order of the names."""
        by_name = {metric.name: metric for metric in self.metrics}
        return [by_name[name] for name in names]


def checked_flags(value: Any, where: str, episode: EpisodeState) -> Tensor:
    """Return what a criterion returned, if it can be used.

    Args:
        value: The value.
        where: Task and criterion, for messages.
        episode: The episodes.

    Raises:
        ConfigError: It is no ``[N]`` tensor of bool.
    """
    if isinstance(value, Tensor) and value.dtype == torch.bool and value.shape == episode.step.shape:
        return value
    expected = f"bool of shape {list(episode.step.shape)}"
    raise ConfigError(f"{where} returned {described(value)}; it must return {expected}")


def checked_value(value: Any, metric: Metric, task: str, episode: EpisodeState) -> Tensor:
    """Return what a metric measured, if it can be used.

    Args:
        value: The value.
        metric: The metric.
        task: Name of the task.
        episode: The episodes.

    Raises:
        ConfigError: It is no ``[N]`` tensor, or for the reducer ``share`` no bool.
    """
    fits = isinstance(value, Tensor) and value.shape == episode.step.shape
    if fits and (metric.reducer != "share" or value.dtype == torch.bool):
        assert isinstance(value, Tensor)
        return value
    expected = f"{'bool' if metric.reducer == 'share' else 'one value a world'} of shape {list(episode.step.shape)}"
    raise ConfigError(f"task {task!r}, metric {metric.name!r} returned {described(value)}; it must return {expected}")


def described(value: Any) -> str:
    """Return type and shape of a value in words."""
    if not isinstance(value, Tensor):
        return type(value).__name__
    return f"{str(value.dtype).removeprefix('torch.')} of shape {list(value.shape)}"


def _check_metric(where: str, metric: Metric) -> None:
    _check_name(where, "name", metric.name)
    if metric.name in RESERVED:
        raise ConfigError(f"{where}: name={metric.name} is a name that results use themselves; choose another one")
    _check_choice(f"{where}: reducer", metric.reducer, REDUCERS, "reducer")
    _check_choice(f"{where}: counts", metric.counts, COUNTS, "choice")
    if metric.training is not None:
        _check_choice(f"{where}: training.over", metric.training.over, OVER, "choice")
    usable = issubclass(metric.measure, Measure) if isinstance(metric.measure, type) else callable(metric.measure)
    if not usable:
        raise ConfigError(f"{where}: measure={metric.measure!r} must be a function, or a subclass of Measure")
    if missing := sorted(getattr(metric.measure, "__abstractmethods__", ())):
        raise ConfigError(f"{where}: measure={metric.measure.__name__} lacks {' and '.join(missing)}; see Measure")


def _check_name(where: str, what: str, name: str) -> None:
    if not _NAME.fullmatch(name):
        raise ConfigError(f"{where}: {what}={name!r} must be letters in lower case, digits and underscores")


def _check_choice(where: str, name: str, known: Collection[str], kind: str) -> None:
    if name not in known:
        close = difflib.get_close_matches(name, known, n=1)
        hint = f" (did you mean {close[0]}?)" if close else ""
        raise ConfigError(f"{where}={name} is no {kind}{hint}; known: {', '.join(known) or 'none'}")
