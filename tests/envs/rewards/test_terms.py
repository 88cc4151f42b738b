"""Every reward term by its formula on constructed states."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
import torch

from skatemount.envs.config.terms import RewardTerm
from skatemount.envs.rewards import REWARDS, RewardTable
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.terms import TaskContext

MakeState = Callable[..., SimState]
MakeEpisode = Callable[..., EpisodeState]

UP = [0.0, 0.0, 30.0]
NONE = [0.0, 0.0, 0.0]
STANCE = [0.15, 0.8, -1.5, -0.15, 0.8, -1.5] * 2


def stance(**changes: float) -> list[float]:
    """The default pose with some joints moved, by index: ``j3=0.1``."""
    joints = list(STANCE)
    for key, value in changes.items():
        joints[int(key[1:])] += value
    return joints


def at_deck(*points: tuple[float, float, float]) -> dict[str, Any]:
    """Feet at places of the board frame, the deck's center being at (0, 0, 0.088)."""
    return {"foot_pos": [[x, y, z + 0.088] for x, y, z in points]}


QUARTER = math.pi / 2
FEET = at_deck((0.2, -0.1, 0.02), (0.2, 0.1, 0.02), (-0.2, -0.1, 0.02), (-0.2, 0.1, 0.02))

# Term, parameters, state, episode, and the value that the formula gives, worked out by hand.
CASES: list[tuple[str, dict, dict, dict, float]] = [
    ("termination", {}, {}, {"terminated": True}, 1),
    ("termination", {}, {}, {}, 0),
    ("alive", {}, {}, {}, 1),
    ("lin_vel_z", {}, {"base_lin_vel": (3, 4, -0.5)}, {}, 0.25),
    ("ang_vel_xy", {}, {"base_ang_vel": (0.3, -0.4, 9)}, {}, 0.25),
    ("flat_orientation", {}, {"base_rpy": (0.3, 0, 1)}, {}, math.sin(0.3) ** 2),
    ("upward", {}, {}, {}, 4),
    ("upward", {}, {"base_rpy": (math.pi, 0, 0)}, {}, 0),
    ("upward", {}, {"base_rpy": (0, QUARTER, 0)}, {}, 1),
    # Soles 0.3 m below the trunk's center are the stance; ours measures from them wherever the robot stands.
    ("base_height", {}, {"base": (0, 0, 0.388), **FEET}, {}, 0),
    ("base_height", {}, {"base": (0, 0, 0.288), **FEET}, {}, 0.01),
    ("base_height", {"target": 0.25}, {"base": (0, 0, 0.388), **FEET}, {}, 0.0025),
    ("base_height_world", {}, {"base": (0, 0, 0.45)}, {}, 0.01),
    ("base_height_world", {"target": 0.4}, {"base": (0, 0, 0.45), **FEET}, {}, 0.0025),
    ("joint_torques", {}, {"joint_torque": [2] * 12}, {}, 48),
    ("joint_acc", {}, {"joint_acc": [-10] * 12}, {}, 1200),
    ("joint_vel", {}, {"joint_vel": [0.5] * 12}, {}, 3),
    ("joint_vel", {"when_mounted": True}, {"joint_vel": [0.5] * 12}, {}, 0),
    ("joint_vel", {"when_mounted": True}, {"joint_vel": [0.5] * 12}, {"mounted": True}, 3),
    # Limits of the constructed robot: hips 0.7, calves -2.6 to -1.
    ("joint_limits", {}, {"joint_pos": stance(j0=0.75, j5=-1.3, j8=0.7)}, {}, 0.2 + 0.2 + 0.2),
    ("joint_limits", {}, {}, {}, 0),
    ("joint_power", {}, {"joint_vel": [2, -2] * 6, "joint_torque": [3] * 12}, {}, 72),
    ("joint_pose", {}, {"joint_pos": stance(j1=0.3, j11=-0.4)}, {}, 0.5),
    ("joint_pose_squared", {}, {"joint_pos": stance(j1=0.3, j11=-0.4)}, {"mounted": True}, 0.25),
    ("joint_pose_squared", {"when_mounted": 10}, {"joint_pos": stance(j1=0.3)}, {"mounted": True}, 0.99),
    ("joint_pose_squared", {"when_mounted": 10}, {"joint_pos": stance(j1=0.3)}, {}, 0.09),
    # Raw angles: the inward hips alone cost half of two times 0.3 squared.
    ("joint_mirror", {}, {}, {}, 0.09),
    ("joint_mirror", {}, {"joint_pos": stance(j1=0.2)}, {}, 0.09 + 0.02),
    ("joint_mirror", {}, {"joint_pos": stance(j7=0.2)}, {}, 0.09 + 0.02),
    ("action_rate", {}, {}, {"action": [1] * 12, "previous_action": [0.5] * 12}, 3),
    ("undesired_contacts", {}, {"body_force": [1.5] + [0.9] * 11 + [7]}, {}, 2),
    ("contact_forces", {}, {"foot_deck_force": [[0, 0, 90], [0, 0, 99], [0, 0, 150], NONE]}, {}, 50),
    (
        "contact_forces",
        {"threshold": 20.0},
        {"foot_deck_force": [UP] * 4, "foot_other_force": [UP, NONE, NONE, NONE]},
        {},
        40 + 10 * 3,
    ),
    ("track_lin_vel", {}, {"base_lin_vel": (0.5, 0, 3)}, {"command": (0.2, 0.4, 9)}, math.exp(-0.25 / 0.25)),
    ("track_lin_vel", {"sigma": 0.25}, {"base_lin_vel": (0.5, 0, 3)}, {"command": (0.25, 0, 0)}, math.exp(-1)),
    ("track_ang_vel", {}, {"base_ang_vel": (5, 5, 0.2)}, {"command": (0, 0, -0.3)}, math.exp(-0.25 / 0.25)),
    ("track_ang_vel", {"sigma": 0.25}, {"base_ang_vel": (0, 0, 0.25)}, {}, math.exp(-1)),
    ("touchdown_without_command", {}, {}, {"touchdown": [1, 0, 1, 0], "command": (0.05, 0.05, 0)}, 2),
    ("touchdown_without_command", {}, {}, {"touchdown": [1, 0, 1, 0], "command": (0, 0, 0.2)}, 0),
    ("feet_air_time", {}, {}, {"touching": [True] * 4, "command": (1, 0, 0)}, 0),
    ("feet_stumble", {}, {"foot_other_force": [UP, UP, [0, 9, 2], UP]}, {}, 1),
    ("feet_stumble", {}, {"foot_other_force": [UP, UP, [0, 9, -2.5], UP]}, {}, 0),
    # On the deck relative to it, on the ground relative to that, in the air not at all.
    (
        "feet_slide",
        {},
        {"foot_vel_board": [[3, 4, 9]] * 4, "foot_vel": [[0.3, 0.4, 9]] * 4},
        {"on_deck": [1, 0, 0, 0], "touching": [1, 1, 0, 0]},
        5 + 0.5,
    ),
    # The paper's measures against the trunk: with its horizontal speed a foot at rest slides.
    (
        "feet_slide_base",
        {},
        {"base_lin_vel": (0.6, -0.8, 0.1)},
        {"touching": [1, 1, 0, 0]},
        2.0,
    ),
    (
        "feet_slide_base",
        {},
        {"base_rpy": (0, 0, QUARTER), "base_lin_vel": (0, -1, 0), "foot_vel": [[1, 0, 0]] * 4},
        {"touching": [1, 1, 1, 1]},
        0.0,
    ),
    (
        "feet_height_body",
        {},
        {"foot_vel": [[0.5, 0, 0]] * 4, "foot_pos_base": [[0, 0, -0.3]] * 4},
        {"command": (0, 0, 0.2)},
        4 * 0.01 * math.tanh(1.0),
    ),
    (
        "feet_height_body",
        {"target": -0.25},
        {"base_lin_vel": (0, 0.5, 0), "foot_pos_base": [[0, 0, -0.3]] * 4},
        {"command": (1, 0, 0)},
        4 * 0.0025 * math.tanh(1.0),
    ),
    ("feet_height_body", {}, {"foot_vel": [[0.5, 0, 0]] * 4}, {"command": (0.09, 0, 0)}, 0),
    # The board.
    ("feet_on_board", {}, {}, {"on_deck": [1, 1, 0, 1]}, 3),
    (
        "feet_on_board_paper",
        {},
        {"foot_deck_force": [[0, 1e-3, 0], UP, UP, NONE], "foot_pos": [[0, 0, z] for z in (0.108, 0.101, 0.099, 0.2)]},
        {},
        2,
    ),
    (
        "feet_on_board_paper",
        {"height": 0.105},
        {"foot_deck_force": [UP] * 4, "foot_pos": [[0, 0, z] for z in (0.108, 0.101, 0.099, 0.2)]},
        {},
        2,
    ),
    ("mounted", {}, {}, {"mounted": True}, 1),
    ("mounted", {}, {}, {"on_deck": [1, 1, 1, 1]}, 0),
    ("mounted", {"ramp": 2.0}, {}, {"mounted": True, "mounted_time": 0.5}, 0.25),
    ("mounted", {"ramp": 2.0}, {}, {"mounted": True, "mounted_time": 3.0}, 1),
    ("mounted", {"ramp": 2.0}, {}, {"mounted_time": 0.0}, 0),
    ("all_feet_on_board", {}, {"body_force": [9] * 13}, {"on_deck": [1, 1, 1, 1]}, 1),
    ("all_feet_on_board", {}, {}, {"on_deck": [1, 1, 0, 1]}, 0),
    ("all_feet_on_board", {}, {}, {"on_deck": [1, 1, 1, 1], "foot_off_deck_contact": 1}, 0),
    ("feet_proximity", {}, FEET, {}, 1),
    # 3 and 4 cm beyond the margin, on the ground: 5 cm aside and 8.8 cm below.
    (
        "feet_proximity",
        {"scale": 0.1, "margin": 0.0},
        at_deck(*[(0.2875 + 0.03, 0.125 + 0.04, 0.02 - 0.088)] * 4),
        {},
        math.exp(-(0.05 + 0.088) / 0.1),
    ),
    ("feet_proximity", {}, at_deck(*[(0.0, 0.0, 0.02 + 0.06)] * 4), {}, math.exp(-0.5)),
    # Under the deck's middle: the way out to the side, 0.105 m, and up.
    ("feet_proximity", {}, at_deck(*[(0.0, 0.0, -0.068)] * 4), {}, math.exp(-(0.105 + 0.088) / 0.12)),
    ("approach", {}, {}, {"previous_distance": 0.52, "distance": 0.50}, 0.5),
    ("approach", {}, {}, {"previous_distance": 0.60, "distance": 0.50}, 1.0),
    ("approach", {"limit": 0.3}, {}, {"previous_distance": 0.4, "distance": 0.50}, -0.3),
    # 3-4-5 in the plane; height does not count.
    ("distance", {}, {"base": (0.3, 0.4, 0.9)}, {}, math.exp(-0.5 / 0.25)),
    ("distance", {"scale": 0.5}, {"base": (0.3, 0.4, 0.9)}, {}, math.exp(-1)),
    ("alignment", {}, {"board_rpy": (0, 0, 0.3)}, {}, math.exp(-0.3 / math.pi / 0.25)),
    ("alignment", {}, {"board_rpy": (0, 0, math.pi - 0.3)}, {}, math.exp(-0.3 / math.pi / 0.25)),
    ("alignment", {"scale": 0.5}, {"board_rpy": (0, 0, -QUARTER)}, {}, math.exp(-1)),
    ("alignment", {}, {"base": (0.2, 0.25, 0.4)}, {}, 0),
    ("alignment", {"gate": 0.4}, {"base": (0.2, 0.25, 0.4)}, {}, 1),
    # Total rotation, and the gate in space to a point on the ground: only a crouching robot passes it.
    ("orientation_paper", {}, {"base": (0.1, 0, 0.27)}, {}, 1),
    ("orientation_paper", {}, {"base": (0.0, 0, 0.31)}, {}, 0),
    ("orientation_paper", {}, {"base": (0.2, 0, 0.25)}, {}, 0),
    ("orientation_paper", {"gate": 0.33}, {"base": (0.2, 0, 0.25)}, {}, 1),
    (
        "orientation_paper",
        {},
        {"base": (0, 0, 0.25), "base_rpy": (0.4, 0, 0)},
        {},
        math.exp(-0.4 / math.pi / 0.25),
    ),
    (
        "orientation_paper",
        {},
        {"base": (0, 0, 0.25), "base_rpy": (0, 0, 3.0)},
        {},
        math.exp(-3.0 / math.pi / 0.25),
    ),
    ("board_flip", {}, {}, {}, 0),
    ("board_flip", {}, {"board_rpy": (1.5, 0, 0)}, {}, 0),
    ("board_flip", {}, {"board_rpy": (1.65, 0, 0)}, {}, 1),
    ("board_speed", {}, {"board_lin_vel": (0.3, 0.4, 1.2)}, {}, 0.5),
    ("board_speed", {"horizontal": False}, {"board_lin_vel": (0.3, 0.4, 1.2)}, {}, 1.3),
    ("board_tilt", {}, {"board_rpy": (0.2, 0, 1)}, {}, math.sin(0.2) ** 2),
    (
        "feet_near_edge",
        {},
        at_deck((0.2, -0.1, 0.02), (0.2, 0.07, 0.02), (-0.26, 0.1, 0.02), (0.28, 0.12, 0.02)),
        {"on_deck": [1, 1, 1, 0]},
        0.02 + 0.0 + 0.03,
    ),
    (
        "feet_near_edge",
        {"half_width": 0.05, "half_length": 0.1},
        at_deck(*[(0.2, 0.1, 0.02)] * 4),
        {"on_deck": [1, 1, 0, 0]},
        0.3,
    ),
    # The deck is 0.575 x 0.25 m: feet 25 and 5 mm inside of its side, 10 mm beyond its end, and one in the air.
    (
        "deck_margin",
        {"margin": 0.05},
        at_deck((0.2, -0.1, 0.02), (0.1, 0.12, 0.02), (-0.2975, 0.0, 0.02), (0.0, 0.12, 0.1)),
        {"on_deck": [1, 1, 1, 0]},
        0.5 + 0.9 + 1.0,
    ),
    ("deck_margin", {}, at_deck(*[(0.2, 0.09, 0.02)] * 4), {"on_deck": [1, 1, 1, 1]}, 0.0),
    ("feet_creep", {}, {"foot_vel_board": [[0.03, 0.04, 9]] * 4}, {"mounted": True}, 0.2),
    ("feet_creep", {}, {"foot_vel_board": [[0.03, 0.04, 9]] * 4}, {}, 0.0),
    # The board under the robot moves as fast as it: nothing to still.
    (
        "still",
        {},
        {"base_rpy": (0, 0, QUARTER), "base_lin_vel": (0, -0.5, 2), "board_lin_vel": (0.5, 0, 0)},
        {"mounted": True},
        0,
    ),
    ("still", {}, {"base_lin_vel": (0.3, 0, 0), "board_lin_vel": (0, -0.4, 0)}, {"mounted": True}, 0.5),
    ("still", {}, {"base_lin_vel": (0.3, 0, 0), "board_lin_vel": (0, -0.4, 0)}, {}, 0),
]


@pytest.mark.parametrize(
    ("name", "params", "state", "episode", "expected"), CASES, ids=[f"{i}_{c[0]}" for i, c in enumerate(CASES)]
)
def test_formula(
    name: str,
    params: dict,
    state: dict,
    episode: dict,
    expected: float,
    context: TaskContext,
    make_state: MakeState,
    make_episode: MakeEpisode,
) -> None:
    sim = make_state(**state)
    value = REWARDS.bind(name, params)(sim, make_episode(sim, **episode), context)
    assert value.shape == (1,)
    assert float(value) == pytest.approx(expected, rel=2e-4, abs=2e-6)


def test_every_term_has_a_case() -> None:
    of_rides = {"ride_yaw_rate", "ride_lean", "ride_shift"}  # test_riding.py has them
    assert {case[0] for case in CASES} | of_rides == set(REWARDS.names())


def test_worlds_do_not_mix(context: TaskContext, make_state: MakeState, make_episode: MakeEpisode) -> None:
    """A batch gives each world what it gets alone."""
    sims = [make_state(**case[2]) for case in CASES]
    episodes = [make_episode(sim, **case[3]) for sim, case in zip(sims, CASES)]

    def values(sim: SimState, episode: EpisodeState) -> torch.Tensor:
        return RewardTable({name: RewardTerm(1.0) for name in REWARDS.names()}, context)(sim, episode)

    alone = torch.cat([values(sim, episode) for sim, episode in zip(sims, episodes)], 1)
    torch.testing.assert_close(values(torch.cat(sims), torch.cat(episodes)), alone)
