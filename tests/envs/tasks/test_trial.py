"""The trial of a task: a function that fails, or returns what cannot be used, is found before anything is trained."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import defaults
import pytest
import torch
from torch import Tensor

from skatemount.envs import MountTask
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.tasks import TASKS, Measure, Metric, TaskDefinition, TrainingValue
from skatemount.envs.tasks.trial import WORLDS, try_task
from skatemount.envs.terms import TaskContext
from skatemount.utils.errors import ConfigError

Inputs = tuple[SimState, EpisodeState, TaskContext]


def lowers(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Write into the state."""
    return sim.base_pos[:, 2].sub_(1.0)


class Second(Measure):
    """Fails in the second step."""

    def begin(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> None:
        self.left = [torch.zeros(len(episode.step))]

    def __call__(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
        return self.left.pop()


class Needs(Second):
    def __init__(self, limit: float):
        self.limit = limit


def task(measure: Any = None, **fields: Any) -> TaskDefinition:
    """Return a task; `measure` and the fields that a metric has are those of its metric."""
    of_metric = {key: fields.pop(key) for key in ("reducer", "most", "training") if key in fields}
    given: dict[str, Any] = {"success": lambda sim, episode, context: episode.mounted, "description": "jump"}
    measure = measure or (lambda sim, episode, context: sim.base_pos[:, 2])
    return TaskDefinition(
        name="jump",
        failure="too_low",
        failure_words="too low",
        metrics=(Metric("height", "height", "height", measure, **of_metric),),
        **given | fields,
    )


@pytest.mark.parametrize(
    ("made", "said"),
    [
        ({"success": lambda sim, episode, context: sim.base_pos[:, 2]}, ": success returned float32 of shape [5]; it "),
        ({"success": lambda sim, episode: True}, ": success failed when tried with 5 worlds: TypeError: "),
        ({"in_state": lambda *_: True}, ": in_state returned bool; it must return bool of shape [5] (tried with 5"),
        (
            {"measure": lambda *_: 1 / 0},
            ", metric 'height' failed when tried with 5 worlds: ZeroDivisionError: division ",
        ),
        (
            {"measure": lambda sim, *_: sim.base_pos},
            ", metric 'height' returned float32 of shape [5, 3]; it must return",
        ),
        ({"reducer": "share"}, ", metric 'height' returned float32 of shape [5]; it must return bool of shape [5]"),
        ({"measure": lowers}, ", metric 'height' failed when tried with 5 worlds: RuntimeError: Inplace update"),
        ({"measure": Second}, ", metric 'height' failed when tried with 5 worlds: IndexError: pop from empty list"),
        ({"measure": Needs}, ", metric 'height' failed when tried with 5 worlds: TypeError: "),
        ({"most": lambda layout: layout.feet}, ", metric 'height': most returned ('FR_foot', "),
        ({"most": lambda layout: layout.foots}, ", metric 'height': most failed when tried with 5 worlds: Attribute"),
        (
            {"training": TrainingValue(lambda episode, context: episode.command)},
            ", metric 'height': training returned float32 of shape [5, 3]; it must return one value a world of ",
        ),
        (
            {"training": TrainingValue(lambda episode, context: episode.velocity)},
            ", metric 'height': training failed when tried with 5 worlds: AttributeError: ",
        ),
    ],
)
def test_a_function_that_cannot_be_used_is_one_line(made: dict[str, Any], said: str, context: TaskContext) -> None:
    with pytest.raises(ConfigError) as error:
        try_task(task(**made), context, lambda n: EpisodeState.zeros(n, context.layout, 7))
    text = str(error.value)
    assert text.startswith(f"task 'jump'{said}") and "\n" not in text
    if " failed " in text:
        assert re.search(rf" \({re.escape(__file__)}, line \d+\)$", text) or "TypeError" in text


def test_the_tasks_of_the_package_pass_and_their_inputs_are_whole_states(context: TaskContext) -> None:
    for name in TASKS.names():
        try_task(TASKS.get(name), context, lambda n: EpisodeState.zeros(n, context.layout, 7, rides=True))
    sizes = {value for name, value in vars(defaults.LAYOUT).items() if name.startswith("num_")}
    assert WORLDS not in {2, 3, 4, len(defaults.LAYOUT.joints), len(defaults.LAYOUT.bodies), *sizes}


def test_a_state_at_rest_has_the_fields_of_a_real_one(make_env: Callable[..., Any]) -> None:
    env = make_env("balance", 2)
    env.reset()
    rest = SimState.at_rest(2, env.mdp.context.layout)
    for name, value in env.sim.items():
        assert (rest.get(name).shape, rest.get(name).dtype) == (value.shape, value.dtype), name


def test_it_is_tried_when_the_task_is_made() -> None:
    before = TASKS.snapshot()
    try:
        TASKS.register(task(lambda sim, episode, context: sim.height))
        with pytest.raises(ConfigError, match=r"^task 'jump', metric 'height' failed when tried with 5 worlds: Attr"):
            MountTask("balance", ["success=jump"])
    finally:
        TASKS.restore(before)
