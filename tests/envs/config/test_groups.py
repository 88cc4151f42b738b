"""Each group of settings refuses what cannot be used, in one line that names the setting as it was written."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from skatemount.utils.errors import ConfigError


@pytest.mark.parametrize("group", ["robot", "board", "physics", "start", "command", "randomization", "sensing"])
def test_the_shipped_settings_are_valid(group: str, make_settings: Callable[..., Any]) -> None:
    settings = make_settings(group)
    before = repr(settings)
    settings.validate(group)
    assert repr(settings) == before


@pytest.mark.parametrize(
    ("group", "setting", "value", "expected"),
    [
        ("command", "mode", "follow", "command.mode=follow must be one of sampled, board, zero, ride"),
        ("command", "turn_to", "left", "command.turn_to=left must be one of nearer, front"),
        ("command", "turn", [1.0, -1.0], "command.turn=[1.0, -1.0] must be a range [low, high] with low <= high"),
        ("command", "resample", math.inf, "command.resample=inf must be above 0 and at most 3600 s"),
        ("command", "standing", -0.1, "command.standing=-0.1 must be from 0 to 1"),
        ("command", "deadband", -1.0, "command.deadband=-1.0 must be from 0 to 20 m/s"),
        ("physics", "timestep", 0.05, "physics.timestep=0.05 must be from 0.0001 to 0.02 s"),
        ("physics", "tolerance", -1.0, "physics.tolerance=-1.0 must be from 0 to 1"),
        ("physics", "impratio", 0.0, "physics.impratio=0.0 must be above 0 and at most 1000"),
        ("physics", "substeps", 0, "physics.substeps=0 must be from 1 to 1000"),
        ("physics", "solver", "Gauss", "physics.solver=Gauss must be one of Newton, CG, PGS"),
        ("physics", "cone", "round", "physics.cone=round must be one of pyramidal, elliptic"),
        ("physics", "cone", "elliptic", "physics.cone=elliptic needs physics.ls_iterations of at least 50, not 10"),
        ("physics", "engine", "gpu", "physics.engine=gpu must be one of cpu, warp"),
        ("physics", "max_contacts", 0, "physics.max_contacts=0 must be from 1 to 10000"),
        ("physics", "threads", -1, "physics.threads=-1 must be 0 (every core) or from 1 to 1024"),
        (
            "randomization",
            "kp",
            [0.0, 1.0],
            "randomization.kp=[0.0, 1.0] must be [low, high], both above 0",
        ),
        ("start", "board_fixed", 1.5, "start.board_fixed=1.5 must be from 0 to 1"),
        ("start", "distance", [-1.0, 1.0], "start.distance=[-1.0, 1.0] must be [low, high], both from 0 to 100 m"),
        ("start", "edge_margin", math.inf, "start.edge_margin=inf must be from 0 to 1 m"),
        (
            "start",
            "board_speed",
            [-0.5, 0.5],
            "start.board_speed=[-0.5, 0.5] must be [low, high], both from 0 to 20 m/s; the direction is drawn",
        ),
        (
            "start",
            "height",
            [-0.1, 0.0],
            "start.height=[-0.1, 0.0] must be [low, high], both from 0 to 5 m; below 0 the robot would start inside",
        ),
        (
            "start",
            "pitch",
            [0.0, 0.6],
            "start.pitch=[0.0, 0.6] must be [low, high], both from -0.5 to 0.5 rad; with a larger tilt, more than the "
            "robot's feet would touch the ground",
        ),
        ("board", "truck_angle", 3.0, "board.truck_angle=3.0 must be from 5 to 85 degrees from the vertical"),
        (
            "board",
            "deck_color",
            [0.0, 2.0, 0.0],
            "board.deck_color=[0.0, 2.0, 0.0] must be a list of numbers, each from 0",
        ),
        ("robot", "kp", -1.0, "robot.kp=-1.0 must be above 0"),
        ("robot", "variant", "b1", "robot.variant=b1 must be one of a1, a1_isaac"),
    ],
)
def test_a_bad_setting_is_one_line_that_names_it(
    group: str, setting: str, value: object, expected: str, make_settings: Callable[..., Any]
) -> None:
    with pytest.raises(ConfigError) as error:
        make_settings(group, **{setting: value}).validate(group)
    message = str(error.value)
    assert message.startswith(expected) and "\n" not in message


def test_no_pushes_is_a_valid_interval(make_settings: Callable[..., Any]) -> None:
    make_settings("randomization", push_interval=None).validate()
    with pytest.raises(ConfigError, match=r"randomization\.push_interval"):
        make_settings("randomization", push_interval=[2.0, 1.0]).validate()


def test_a_control_step_is_some_physics_steps(make_settings: Callable[..., Any]) -> None:
    assert make_settings("physics", timestep=0.004, substeps=5).control_step == pytest.approx(0.02)
