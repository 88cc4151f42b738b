"""The reward table: weights, clamps, the upright factor, and the paper's table."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from skatemount.config import compose
from skatemount.envs.config.terms import RewardTerm
from skatemount.envs.rewards import REWARDS, RewardTable
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.terms import TaskContext
from skatemount.utils.errors import ConfigError

MakeState = Callable[..., SimState]
MakeEpisode = Callable[..., EpisodeState]

UP = [0.0, 0.0, 30.0]
ON_DECK = [[x, y, 0.108] for x in (0.2, -0.2) for y in (-0.1, 0.1)]

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
    "feet_air_time",
    "orientation_paper",
    "ride_yaw_rate", "ride_lean", "ride_shift",
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
    sim = make_state(base=(0, 0, 0.29), foot_deck_force=[UP] * 4, foot_pos=ON_DECK)
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
        (
            "feet_on_bord",
            RewardTerm(1.0),
            ["reward.feet_on_bord", "did you mean feet_on_board or", "skatemount list rewards"],
        ),
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
