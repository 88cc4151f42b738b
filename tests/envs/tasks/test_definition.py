"""Definitions of tasks: what they refuse, and how they put numbers into words."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import defaults
import pytest
import torch
from torch import Tensor

from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.tasks import Measure, Metric, TaskDefinition, TrainingValue
from skatemount.envs.tasks.definition import checked_value
from skatemount.envs.terms import TaskContext
from skatemount.utils.errors import ConfigError


def never(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Test for nothing."""
    return torch.zeros(1, dtype=torch.bool)


def height(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    return sim.base_pos[:, 2]


class Unfinished(Measure):
    """A measurement without its methods."""


def metric(name: str = "height", **fields: Any) -> Metric:
    given: dict[str, Any] = {"label": name, "meaning": name, "measure": height} | fields
    return Metric(name, **given)


def task(*metrics: Metric, **fields: Any) -> TaskDefinition:
    given: dict[str, Any] = {
        "name": "jump",
        "description": "jump",
        "success": never,
        "failure": "too_low",
        "failure_words": "too low",
    }
    return TaskDefinition(**given | fields, metrics=metrics)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: task(name="High Jump"), "task 'High Jump': name='High Jump' must be letters in lower case"),
        (lambda: task(failure=""), "task 'jump': failure='' must be letters in lower case"),
        (lambda: task(success=None), "task 'jump': success=None must be a function of sim, episode and context"),
        (lambda: task(metric(), metric()), "task 'jump': two metrics have the name 'height'"),
        (lambda: task(metric("success")), "task 'jump', metric 'success': name=success is a name that results use"),
        (
            lambda: task(metric(reducer="medain")),
            "task 'jump', metric 'height': reducer=medain is no reducer (did you mean median?); known: mean, median, "
            "share",
        ),
        (lambda: task(metric(counts="most")), "task 'jump', metric 'height': counts=most is no choice; known: all, "),
        (
            lambda: task(metric(training=TrainingValue(lambda episode, context: episode.distance, "start"))),
            "task 'jump', metric 'height': training.over=start is no choice; known: steps, end, success",
        ),
        (lambda: task(metric(measure=3)), "task 'jump', metric 'height': measure=3 must be a function, or a subclass"),
        (lambda: task(metric(measure=dict)), "task 'jump', metric 'height': measure=<class 'dict'> must be a function"),
        (
            lambda: task(metric(measure=Unfinished)),
            "task 'jump', metric 'height': measure=Unfinished lacks __call__ and begin; see Measure",
        ),
        (
            lambda: task(metric(), score={"hight": 1.0}),
            "task 'jump': score=hight is no metric of it (did you mean height?); known: height",
        ),
        (lambda: task(overview=("height",)), "task 'jump': overview=height is no metric of it; known: none"),
        (lambda: task(progress=("height",)), "task 'jump': progress=height is no metric of it; known: none"),
    ],
)
def test_a_wrong_definition_is_one_line_that_names_it(make: Callable[[], TaskDefinition], said: str) -> None:
    with pytest.raises(ConfigError) as error:
        make()
    assert str(error.value).startswith(said) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("value", "found"),
    [(torch.zeros(3), "float32 of shape [3]"), (torch.zeros(3, 1) > 0, "bool of shape [3, 1]"), (True, "bool")],
)
def test_a_criterion_returns_a_flag_for_each_world(context: TaskContext, value: Any, found: str) -> None:
    episode = EpisodeState.zeros(3, defaults.LAYOUT)
    with pytest.raises(ConfigError) as error:
        task(success=lambda *_: value).succeeded(None, episode, context)  # type: ignore[arg-type]
    assert str(error.value) == f"task 'jump': success returned {found}; it must return bool of shape [3]"


def test_a_metric_returns_a_value_for_each_world() -> None:
    episode = EpisodeState.zeros(3, defaults.LAYOUT)
    for value in (torch.zeros(3), torch.zeros(3, dtype=torch.int64)):
        assert checked_value(value, metric(), "jump", episode) is value
    wrong = (
        "task 'jump', metric 'height' returned float32 of shape [3, 2]; it must return one value a world of shape [3]"
    )
    with pytest.raises(ConfigError) as error:
        checked_value(torch.zeros(3, 2), metric(), "jump", episode)
    assert str(error.value) == wrong
    with pytest.raises(ConfigError, match=r"returned float32 of shape \[3\]; it must return bool of shape \[3\]$"):
        checked_value(torch.zeros(3), metric(reducer="share"), "jump", episode)


def test_a_measure_with_memory_starts_afresh(
    make_state: Callable[..., SimState], make_episode: Callable[..., EpisodeState], context: TaskContext
) -> None:
    class Highest(Measure):
        def begin(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> None:
            self.highest = sim.base_pos[:, 2]

        def __call__(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
            self.highest = torch.maximum(self.highest, sim.base_pos[:, 2])
            return self.highest

    def state(height: float) -> SimState:
        return make_state(base=(0.0, 0.0, height))

    found = metric(measure=Highest)
    first = found.start(state(0.5), make_episode(), context)
    second = found.start(state(0.25), make_episode(), context)
    assert [float(first(state(z), make_episode(), context)) for z in (0.25, 0.75, 0.5)] == [0.5, 0.75, 0.75]
    assert float(second(state(0.125), make_episode(), context)) == 0.25
    assert float(metric().start(state(1.0), make_episode(), context)(state(0.5), make_episode(), context)) == 0.5


def test_values_in_words() -> None:
    plain = metric(unit="m", note="an episode", digits=1)
    assert (plain.short(2.04), plain.text(2.04), plain.text(None)) == ("2.0 m", "2.0 m an episode", "-")
    assert plain.short(math.nan) == plain.short(None) == "-"
    feet = metric(most=lambda layout: layout.num_feet, note="in the last second")
    assert feet.text(3.5, 4) == "3.50 of 4 in the last second"
    assert task(feet).most(defaults.LAYOUT) == {"height": 4}
    assert metric(reducer="share").short(0.5) == "50.0%"
    middle = metric(reducer="median", unit="s")
    assert middle.text({"median": 1.0, "p95": 2.0}) == "median 1.00 s, 95 % within 2.00 s"


def test_the_score_decides_which_checkpoint_is_best() -> None:
    jump = task(metric(), metric("effort"), score={"height": 0.5, "effort": -0.25})
    evaluated = {"Evaluation/success": 0.5, "Evaluation/height": 2.0, "Evaluation/effort": 1.0}
    assert jump.score_of(evaluated) == 0.5 + 1.0 - 0.25
    assert jump.score_of({"Evaluation/success": 0.5, "Evaluation/height": 2.0}) == 1.5  # no value of the other one
    assert jump.score_of({"Success/rate": 1.0}) is None
