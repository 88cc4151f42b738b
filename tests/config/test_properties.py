"""Properties of settings and start states that hold for values that nobody wrote down."""

from __future__ import annotations

import copy
import dataclasses
import math
from typing import Any

import torch
from composed import stage_config
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tensordict import TensorDict

from skatemount.config import TrainConfig
from skatemount.envs import MountEnv, MountTask
from skatemount.utils.bounds import Bounds, bounds_of
from skatemount.utils.errors import ConfigError

GROUPS = (
    "robot",
    "board",
    "physics",
    "start",
    "command",
    "randomization",
    "sensing",
    "algorithm",
    "network",
    "collector",
    "distributed",
    "logger",
)

# The same examples in every run, however long they take: a test must not fail by chance.
FIXED = settings(
    derandomize=True, deadline=None, database=None, suppress_health_check=list(HealthCheck), print_blob=False
)

ANY_NUMBER = st.one_of(
    st.integers(-(10**12), 10**12),
    st.floats(allow_nan=True, allow_infinity=True),
    st.sampled_from([0, 0.0, -1, 1e-300, 1e300, math.nan, math.inf, -math.inf]),
)


def declared() -> list[tuple[str, str, Bounds]]:
    """Return group, name and bounds of every setting that declares them."""
    kinds = {group: type(getattr(stage_config("balance"), group)) for group in GROUPS}
    return [(group, name, each) for group, kind in kinds.items() for name, each in bounds_of(kind).items()]


def changed(group: str, **values: Any) -> TrainConfig:
    config = copy.copy(stage_config("balance"))
    setattr(config, group, dataclasses.replace(getattr(config, group), **values))
    return config


@settings(FIXED, max_examples=300)
@given(data=st.data())
def test_any_value_is_accepted_or_refused_in_one_line_that_names_it(data: st.DataObject) -> None:
    group, name, bounds = data.draw(st.sampled_from(declared()))
    value: Any = data.draw(ANY_NUMBER)
    if bounds.shape != "number":
        value = sorted([value, data.draw(ANY_NUMBER)], key=str)
    try:
        changed(group, **{name: value}).validate()
    except ConfigError as error:
        text = str(error)
        assert name in text and "\n" not in text and len(text) < 800
    else:
        parts = [value] if bounds.shape == "number" else value
        assert all(map(bounds.allow, parts)) and all(map(math.isfinite, parts))


def ranges(low: float, high: float) -> st.SearchStrategy[list[float]]:
    return st.lists(st.floats(low, high), min_size=2, max_size=2).map(sorted)


STARTS = {
    "x": ranges(-2, 2),
    "y": ranges(-2, 2),
    "both_sides": st.booleans(),
    "distance": st.one_of(st.none(), ranges(0, 2)),
    "yaw": ranges(-4, 4),
    "roll": ranges(-0.5, 0.5),
    "pitch": ranges(-0.5, 0.5),
    "height": ranges(0, 1),
    "lin_vel": ranges(-3, 3),
    "ang_vel": ranges(-5, 5),
    "joint_pos": ranges(-0.5, 0.5),
    "joint_vel": ranges(-10, 10),
    "step_height": st.one_of(st.none(), ranges(0.005, 0.088)),
    "board_fixed": st.floats(0, 0.99),
    "board_speed": ranges(0, 2),
    "edge_margin": st.floats(0, 0.05),
    "force": ranges(-50, 50),
    "torque": ranges(-5, 5),
}

BOARDS = {
    "mass": st.floats(1, 10),
    "truck_stiffness": st.floats(0.5, 200),
    "truck_damping": st.floats(0.1, 5),
    "truck_limit": st.floats(1, 10),
    "wheel_friction": st.floats(0, 0.1),
    "wheel_grip": st.floats(0.1, 2),
    "deck_friction": st.floats(0.1, 2),
}


def steps_finitely(config: TrainConfig) -> None:
    """Build two worlds of a task and check that the start and three steps are finite."""
    config.physics = dataclasses.replace(config.physics, num_worlds=2, threads=1)
    config.validate()
    env = MountEnv(MountTask(config=config), seed=1)
    try:
        seen = env.reset()
        for _ in range(3):
            assert isinstance(seen, TensorDict)
            assert all(value.isfinite().all() for value in seen.values(True, True) if value.is_floating_point())
            action = 4 * torch.rand(seen.batch_size + env.action_spec.shape[-1:]) - 2
            seen = env.step_mdp(env.step(seen.set("action", action)))
    finally:
        env.close()


@settings(FIXED, max_examples=4)
@given(start=st.fixed_dictionaries(STARTS))
def test_accepted_starts_step_finitely(start: dict[str, Any]) -> None:
    torch.manual_seed(0)
    steps_finitely(changed("start", **start))


@settings(FIXED, max_examples=3)
@given(board=st.fixed_dictionaries(BOARDS))
def test_accepted_boards_step_finitely(board: dict[str, Any]) -> None:
    torch.manual_seed(0)
    steps_finitely(changed("board", **board))
