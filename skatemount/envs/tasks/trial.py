"""A trial of a task: all its functions are called once, because a training calls some of them only after hours."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import torch
from torch import Tensor

from skatemount.envs.robots.layout import JointLayout
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.tasks.definition import Metric, TaskDefinition, checked_flags, checked_value, described
from skatemount.envs.terms import TaskContext
from skatemount.utils.errors import ConfigError, reason

WORLDS = 5
"""Number of worlds of the trial. No other dimension of a state has this size, so a wrong one is noticed."""


def try_task(task: TaskDefinition, context: TaskContext, episodes: Callable[[int], EpisodeState]) -> None:
    """Call the criterion, the metrics and the other functions of a task with states at rest.

    Args:
        task: The task.
        context: Its constants.
        episodes: Takes a number of worlds and returns episodes without any history.

    Raises:
        ConfigError: A function fails, or returns a value of the wrong shape or type.
    """
    # As in an environment: a function that writes into its inputs fails.
    with torch.inference_mode():
        episode = episodes(WORLDS)
        sim = SimState.at_rest(WORLDS, context.layout, episode.step.device)
    where = f"task {task.name!r}"
    _try(f"{where}: success", lambda: task.succeeded(sim, episode, context))
    if (in_state := task.in_state) is not None:
        name = f"{where}: in_state"
        _try(name, lambda: checked_flags(in_state(sim, episode, context), name, episode))
    for metric in task.metrics:
        name = f"{where}, metric {metric.name!r}"
        _try(name, partial(_try_metric, metric, task.name, sim, episode, context))
        _try(f"{name}: most", partial(_try_most, metric, task.name, context.layout))
        if metric.training is not None:
            _try(f"{name}: training", partial(_try_training, metric, task.name, episode, context))


def _try(where: str, function: Callable[[], Any]) -> None:
    try:
        function()
    except ConfigError as error:
        raise ConfigError(f"{error} (tried with {WORLDS} worlds)") from error
    except Exception as error:
        raise ConfigError(f"{where} failed when tried with {WORLDS} worlds: {reason(error)}") from error


def _try_metric(metric: Metric, task: str, sim: SimState, episode: EpisodeState, context: TaskContext) -> None:
    measure = metric.start(sim, episode, context)
    for _ in range(2):
        # Twice, because a measurement with memory may fail in its second step.
        value = checked_value(measure(sim, episode, context), metric, task, episode)
    values = value.to(torch.float32)
    metric.reduce.number(metric.reduce.summarize(values[values.isfinite()]))


def _try_most(metric: Metric, task: str, layout: JointLayout) -> None:
    most = None if metric.most is None else metric.most(layout)
    if most is not None and (not isinstance(most, int | float) or not math.isfinite(most)):
        raise ConfigError(f"task {task!r}, metric {metric.name!r}: most returned {most!r}; it must return a number")


def _try_training(metric: Metric, task: str, episode: EpisodeState, context: TaskContext) -> None:
    assert metric.training is not None
    value = metric.training.function(episode, context)
    if not isinstance(value, Tensor) or value.shape != episode.step.shape:
        expected = f"one value a world of shape {list(episode.step.shape)}"
        where = f"task {task!r}, metric {metric.name!r}: training"
        raise ConfigError(f"{where} returned {described(value)}; it must return {expected}")
