"""The registry of terms, and the constants that terms share."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, Literal

import pytest
import torch
from torch import Tensor

from skatemount.envs import MountTask
from skatemount.envs.terms import Registry, TaskContext
from skatemount.utils.errors import ConfigError

CONTEXT = SimpleNamespace(layout=None)
"""The part of a context that the registry itself looks at."""


@pytest.fixture
def registry() -> Registry:
    made = Registry("reward")

    @made.register("properties")
    def hop(
        sim: SimpleNamespace, episode: None, context: None, scale: float = 2.0, side: Literal["left", "right"] = "left"
    ) -> Tensor:
        return sim.base_pos * scale if side == "left" else -sim.base_pos * scale

    return made


def test_a_term_is_bound_to_its_parameters(registry: Registry) -> None:
    assert registry.names() == ["hop"] and registry.attributes("hop") == "properties"
    ones = SimpleNamespace(base_pos=torch.ones(2))
    assert registry.bind("hop", {})(ones, None, CONTEXT).tolist() == [2, 2]
    assert registry.bind("hop", {"scale": 3, "side": "right"})(ones, None, CONTEXT).tolist() == [-3, -3]


@pytest.mark.parametrize(
    ("returned", "expected"),
    [
        (lambda sim: sim.base_pos[:, None], "returned float32 of shape [2, 1]; it must return float32 of shape [2]"),
        (lambda sim: sim.base_pos > 0, "returned bool of shape [2]; it must return float32 of shape [2]"),
        (lambda sim: sim.base_pos.double(), "returned float64 of shape [2]; it must return float32 of shape [2]"),
        (lambda sim: 1.0, "returned float; it must return float32 of shape [2]"),
    ],
)
def test_a_wrong_result_of_a_plugins_term_is_an_error(returned: Callable[..., Any], expected: str) -> None:
    made = Registry("reward")

    @made.register()
    def hop(sim: SimpleNamespace, episode: None, context: None) -> Tensor:
        return returned(sim)

    with pytest.raises(ConfigError) as error:
        made.bind("hop", {})(SimpleNamespace(base_pos=torch.ones(2)), None, CONTEXT)
    assert str(error.value) == f"reward.hop of {__name__} {expected}"


def test_terms_of_columns_and_flags_have_other_shapes() -> None:
    sim = SimpleNamespace(base_pos=torch.ones(2))
    wide = Registry("observation", columns=lambda size, layout, params: size)
    ends = Registry("termination", flags=True)

    def hop(sim: SimpleNamespace, episode: None, context: None) -> Tensor:
        return sim.base_pos.expand(3, 2).T

    def high(sim: SimpleNamespace, episode: None, context: None) -> Tensor:
        return sim.base_pos > 0

    wide.register(3)(hop)
    ends.register()(high)
    assert wide.bind("hop", {})(sim, None, CONTEXT).shape == (2, 3)
    assert ends.bind("high", {})(sim, None, CONTEXT).all()
    ends.register()(hop)
    with pytest.raises(ConfigError, match=r"returned float32 of shape \[2, 3\]; it must return bool of shape \[2\]"):
        ends.bind("hop", {})(sim, None, CONTEXT)


def test_a_function_that_is_no_term_is_an_error() -> None:
    made = Registry("reward")

    def state_first(state: None, episode: None, context: None) -> None: ...

    def untyped(sim: None, episode: None, context: None, size=1.0) -> None: ...

    def required(sim: None, episode: None, context: None, size: float) -> None: ...

    for function, expected in (
        (state_first, r"takes \(state, episode, context\); a term takes \(sim, episode, context\)"),
        (untyped, "parameter size needs a type and a default"),
        (required, "parameter size needs a type and a default"),
    ):
        before = made.snapshot()
        made.register()(function)
        with pytest.raises(ConfigError, match=f"^reward {function.__name__} of {__name__}.*{expected}"):
            made.check()
        with pytest.raises(ConfigError, match=expected):
            made.bind(function.__name__, {})
        made.restore(before)
        assert made.names() == []


def test_a_name_is_registered_once(registry: Registry) -> None:
    def hop(sim: Tensor, episode: None, context: None) -> Tensor:
        return sim

    with pytest.raises(ValueError, match="'hop' is registered twice"):
        registry.register()(hop)


@pytest.mark.parametrize(
    ("name", "params", "table", "expected"),
    [
        ("hup", {}, None, "reward.hup is not a known reward; did you mean hop? (skatemount list rewards has all)"),
        ("hop", {"size": 1}, None, "reward.hop.params.size is not a parameter; known: scale, side"),
        ("hop", {"scale": 0.0}, None, "reward.hop.params.scale=0.0 must be above 0, because the term divides by it"),
        ("hop", {"scale": "x"}, None, "reward.hop.params.scale=x must be of type float"),
        ("hop", {"scale": True}, None, "reward.hop.params.scale=True must be of type float"),
        ("hop", {"scale": float("nan")}, None, "reward.hop.params.scale=nan must be a finite number"),
        ("hop", {"side": "up"}, "mine.table", "mine.table.hop.params.side=up must be left or right"),
        ("hop", {"side": 1}, "mine.table", "mine.table.hop.params.side=1 must be left or right"),
    ],
)
def test_errors_name_the_setting(registry: Registry, name: str, params: dict, table: str | None, expected: str) -> None:
    with pytest.raises(ConfigError) as error:
        registry.bind(name, params, table)
    assert str(error.value) == expected


def test_constants_are_those_of_the_scene() -> None:
    task = MountTask(stage="mount")
    context = TaskContext.of(task.scene, 5.0)
    step = task.config.physics.timestep * task.config.physics.substeps
    assert context.control_step == step and context.episode_steps == round(5.0 / step)
    assert context.deck_half == (task.config.board.deck_length / 2, task.config.board.deck_width / 2)
    low, high = torch.as_tensor(task.scene.robot.joint_range, dtype=torch.float32).unbind(1)
    soft_low, soft_high = context.soft_limits.unbind(1)
    torch.testing.assert_close(soft_high - soft_low, 0.9 * (high - low))
    torch.testing.assert_close(soft_high + soft_low, high + low)
    # A hip at the angle of the stance lowers the foot a little less than the straight legs' projection.
    thigh, calf = task.config.robot.thigh, task.config.robot.calf
    reach = 0.2 * (torch.cos(torch.tensor(thigh)) + torch.cos(torch.tensor(thigh + calf)))
    assert 0.9 * float(reach) < context.stance_height - context.foot_radius < 1.05 * float(reach)
