"""Every reward term by its formula on constructed states, and the table that weighs them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
import torch

from skatemount.config import compose
from skatemount.envs.rewards import REWARDS, RewardTable, RewardTerm
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.terms import TaskContext
from skatemount.errors import ConfigError

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
    """Feet at places of the board frame, the deck's centre being at (0, 0, 0.088)."""
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
    # Soles 0.3 m below the trunk's centre are the stance; ours measures from them wherever the robot stands.
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
    ("all_feet_on_board", {}, {"body_force": [9] * 13}, {"on_deck": [1, 1, 1, 1]}, 1),
    ("all_feet_on_board", {}, {}, {"on_deck": [1, 1, 0, 1]}, 0),
    ("all_feet_on_board", {}, {"foot_other_force": [UP, NONE, NONE, NONE]}, {"on_deck": [1, 1, 1, 1]}, 0),
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
    assert {case[0] for case in CASES} == set(REWARDS.names())


# Weight, whether "upright" multiplies it, and the clamp: the table of the paper's code.
PAPER = {
    "termination": (4.0, False, None),  # 200 per second x 0.02 s, each time
    "lin_vel_z": (2.0, True, 1.0),
    "ang_vel_xy": (0.05, True, 5.0),
    "base_height_world": (10.0, True, 0.5),
    "joint_torques": (2.5e-5, False, None),
    "joint_acc": (2.5e-7, False, None),
    "joint_limits": (5.0, False, None),
    "joint_power": (2e-5, False, 1e5),
    "joint_pose": (1.0, True, 10.0),
    "joint_mirror": (0.05, True, 10.0),
    "action_rate": (0.01, False, None),
    "undesired_contacts": (1.0, True, None),
    "contact_forces": (0.001, False, None),
    "track_lin_vel": (3.0, True, None),
    "track_ang_vel": (1.5, True, None),
    "touchdown_without_command": (0.1, True, None),
    "feet_stumble": (0.1, True, 1.0),
    "feet_slide_base": (0.1, True, 5.0),
    "feet_height_body": (5.0, True, 0.1),
    "upward": (3.0, False, 15.0),
    "feet_on_board_paper": (5.0, True, 4.0),
    "orientation_paper": (1.0, True, None),
    "distance": (1.0, True, None),
}
ADDED = {
    "alive", "upward", "track_lin_vel", "track_ang_vel", "touchdown_without_command", "feet_on_board", "mounted",
    "feet_on_board_paper", "all_feet_on_board", "feet_proximity", "approach", "distance", "alignment",
    "orientation_paper",
}  # fmt: skip


def test_rewards_are_added_and_penalties_subtracted() -> None:
    assert {name for name in REWARDS.names() if REWARDS.attributes(name).sign > 0} == ADDED
    assert {name for name in REWARDS.names() if REWARDS.attributes(name).event} == {"termination"}


def paper_terms() -> dict[str, RewardTerm]:
    return compose(None, ["reward=paper"]).reward


def test_paper_weights() -> None:
    terms = paper_terms()
    counted = {name: (t.weight, t.upright, t.clip) for name, t in terms.items() if t.weight > 0}
    assert counted == PAPER
    assert terms["track_lin_vel"].params["sigma"] ** 2 == pytest.approx(0.25)
    assert terms["track_ang_vel"].params["sigma"] ** 2 == pytest.approx(0.25)


def test_paper_ceiling(
    make_context: Callable[..., TaskContext], make_state: MakeState, make_episode: MakeEpisode
) -> None:
    """Upright, at rest and still, aligned, four feet on the deck, low enough for the gate: 38.5 a second."""
    context = make_context(control_step=0.02)
    rewards = RewardTable(paper_terms(), context)
    sim = make_state(base=(0, 0, 0.29), foot_deck_force=[UP] * 4, **FEET)
    shares = dict(zip(rewards.names, rewards(sim, make_episode(sim))[:, 0].tolist()))
    per_second = {name: value / 0.02 for name, value in shares.items()}
    terms = {"upward": 12, "track_lin_vel": 3, "track_ang_vel": 1.5, "feet_on_board_paper": 20}
    terms |= {"orientation_paper": 1, "distance": 1}
    assert {name: per_second[name] for name in terms} == pytest.approx(terms, rel=1e-3)
    # 192.5 in an episode of 5 s; crouching for the gate costs 10 x 0.06^2 of it.
    assert sum(v for v in per_second.values() if v > 0) * 5 == pytest.approx(192.5, rel=1e-3)
    assert per_second["base_height_world"] == pytest.approx(-0.036, rel=1e-3)


def test_paper_clamps(
    make_context: Callable[..., TaskContext], make_state: MakeState, make_episode: MakeEpisode
) -> None:
    rewards = RewardTable(paper_terms(), make_context(control_step=0.02))
    # A tenth of the vertical counts as 0.1 / 0.7 of upright, before the clamp.
    sim = make_state(base=(0, 0, 30.0), base_lin_vel=(0, 0, 9), base_ang_vel=(99, 0, 0), joint_pos=[99] * 12)
    shares = dict(zip(rewards.names, rewards(sim, make_episode(sim))[:, 0].tolist()))
    clamped = {"lin_vel_z": 2.0 * 1, "ang_vel_xy": 0.05 * 5, "base_height_world": 10 * 0.5, "joint_pose": 10.0}
    for name, value in clamped.items():
        assert shares[name] == pytest.approx(-value * 0.02, rel=1e-4), name


def test_weights_are_per_second_and_events_are_not(
    make_context: Callable[..., TaskContext], make_state: MakeState, make_episode: MakeEpisode
) -> None:
    sim = make_state(base_ang_vel=(1, 0, 0))
    episode = make_episode(sim, terminated=True)
    terms = {"alive": RewardTerm(3.0), "ang_vel_xy": RewardTerm(2.0), "termination": RewardTerm(4.0)}
    for step in (0.02, 0.04):
        shares = RewardTable(terms, make_context(control_step=step))(sim, episode)
        assert shares.shape == (3, 1)
        assert shares[:, 0].tolist() == pytest.approx([3 * step, -2 * step, -4.0])


@pytest.mark.parametrize(
    ("roll", "factor"),
    [(0.0, 1.0), (math.radians(44), 1.0), (math.radians(60), 0.5 / 0.7), (math.radians(89.99), 0.0), (3.0, 0.0)],
)
def test_upright_factor(
    roll: float, factor: float, context: TaskContext, make_state: MakeState, make_episode: MakeEpisode
) -> None:
    sim = make_state(base_rpy=(roll, 0, 0))
    terms = {"alive": RewardTerm(1.0, upright=True), "mounted": RewardTerm(1.0)}
    shares = RewardTable(terms, context)(sim, make_episode(sim, mounted=True))
    assert float(shares[0]) == pytest.approx(0.04 * factor, abs=1e-5)
    assert float(shares[1]) == pytest.approx(0.04)


def test_clip_is_of_the_term_with_its_upright_factor(
    context: TaskContext, make_state: MakeState, make_episode: MakeEpisode
) -> None:
    sim = make_state(base_rpy=(math.radians(60), 0, 0), base_lin_vel=(0, 0, 2))
    shares = RewardTable({"lin_vel_z": RewardTerm(1.0, upright=True, clip=3.0)}, context)(sim, make_episode(sim))
    assert float(shares) == pytest.approx(-0.04 * 4 * 0.5 / 0.7, rel=1e-4)
    shares = RewardTable({"lin_vel_z": RewardTerm(1.0, upright=True, clip=2.0)}, context)(sim, make_episode(sim))
    assert float(shares) == pytest.approx(-0.04 * 2)


def test_weight_0_leaves_a_term_out(context: TaskContext, make_state: MakeState, make_episode: MakeEpisode) -> None:
    sim = make_state()
    table = RewardTable({"alive": RewardTerm(0.0), "upward": RewardTerm(1.0)}, context)
    assert table.names == ["upward"]
    assert table(sim, make_episode(sim)).shape == (1, 1)
    assert RewardTable({"alive": RewardTerm(0.0)}, context)(sim, make_episode(sim)).shape == (0, 1)


@pytest.mark.parametrize(
    ("name", "term", "expected"),
    [
        ("alive", RewardTerm(-2.0), ["reward.alive.weight=-2.0", "0 or more", "added", "2.0"]),
        ("lin_vel_z", RewardTerm(-2.0), ["reward.lin_vel_z.weight=-2.0", "subtracted"]),
        ("alive", RewardTerm(math.nan), ["reward.alive.weight=nan", "0 or more"]),
        ("alive", RewardTerm(math.inf), ["reward.alive.weight=inf", "0 or more"]),
        ("feet_on_bord", RewardTerm(1.0), ["reward.feet_on_bord", "did you mean feet_on_board?", "track_ang_vel"]),
        ("distance", RewardTerm(1.0, params={"sigma": 1}), ["reward.distance.params.sigma", "known: scale"]),
        ("alive", RewardTerm(0.0, params={"x": 1}), ["reward.alive.params.x", "known: none"]),
    ],
)
def test_bad_terms_are_one_clear_line(name: str, term: RewardTerm, expected: list[str], context: TaskContext) -> None:
    with pytest.raises(ConfigError) as error:
        RewardTable({name: term}, context)
    message = str(error.value)
    assert "\n" not in message
    for text in expected:
        assert text in message


def test_worlds_do_not_mix(context: TaskContext, make_state: MakeState, make_episode: MakeEpisode) -> None:
    """A batch gives each world what it gets alone."""
    sims = [make_state(**case[2]) for case in CASES]
    episodes = [make_episode(sim, **case[3]) for sim, case in zip(sims, CASES)]
    table = RewardTable({name: RewardTerm(1.0) for name in REWARDS.names()}, context)
    alone = torch.cat([table(sim, episode) for sim, episode in zip(sims, episodes)], 1)
    torch.testing.assert_close(table(torch.cat(sims), torch.cat(episodes)), alone)
