"""Rewards for riding, with numbers worked out by hand."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
import torch

from skatemount.envs.rewards import REWARDS
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.terms import TaskContext

STEERING = (0.25, 0.35)


@pytest.mark.parametrize(
    ("command", "rate", "lean", "expected"),
    [
        # v = 0.5 m/s: 0.2 rad/s are commanded, and a lean of asin(0.1).
        ((1.0, 0.5, 0.4), 0.2, math.asin(0.1), (1.0, 1.0)),
        ((1.0, 0.5, 0.4), 0.08, math.asin(0.1) - 0.03, (math.exp(-1), math.exp(-1))),
        # The other side.
        ((1.0, 0.5, -0.4), -0.2, -math.asin(0.1), (1.0, 1.0)),
        ((1.0, 0.5, -0.4), 0.2, 0.03 - math.asin(0.1), (math.exp(-((0.4 / 0.12) ** 2)), math.exp(-1))),
        # No ride.
        ((0.0, 0.0, 0.0), 0.0, 0.0, (0.0, 0.0)),
        (None, 0.0, 0.0, (0.0, 0.0)),
    ],
)  # fmt: skip
def test_terms(
    command: tuple[float, ...] | None,
    rate: float,
    lean: float,
    expected: tuple[float, float],
    make_state: Callable[..., SimState],
    make_episode: Callable[..., EpisodeState],
    make_context: Callable[..., TaskContext],
) -> None:
    sim = make_state(board_rpy=(-lean, 0, 0), board_lin_vel=(0.5, 0, 0), board_ang_vel=(0, 0, rate))
    episode, context = make_episode(sim), make_context(steering=STEERING)
    episode.ride_command = None if command is None else torch.tensor([command])
    found = [float(REWARDS.bind(name, {})(sim, episode, context)) for name in ("ride_yaw_rate", "ride_lean")]
    assert found == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize(
    ("turn", "speed", "place", "expected"),
    [
        # A lean of 0.1 rad. At rest the lever is 0.3 m, at 0.981 m/s it is 0.3 + 0.981^2 * 0.35 / (9.81 * 0.25) m.
        (1, 0.0, 0.030, 1.0),
        (1, 0.0, 0.010, math.exp(-1)),
        (1, 0.981, 0.0437342, 1.0),
        # The other side.
        (-1, 0.0, -0.030, 1.0),
        (-1, 0.0, 0.030, math.exp(-9)),
    ],
)
def test_shift(
    turn: int,
    speed: float,
    place: float,
    expected: float,
    make_state: Callable[..., SimState],
    make_episode: Callable[..., EpisodeState],
    make_context: Callable[..., TaskContext],
) -> None:
    params = {"sigma": 0.02, "stiffness": 0.65, "height": 0.35}
    term, context = REWARDS.bind("ride_shift", params), make_context(steering=STEERING)
    curvature = turn * math.sin(0.1) / STEERING[0]
    # The trunk faces the end x > 0, then the other one: what is on its left is then at y < 0.
    for yaw, sign in ((0.0, 1), (math.pi, -1)):
        sim = make_state((0, sign * place, 0.4), (0, 0, yaw), board=(0, 0, 0.088), board_lin_vel=(sign * speed, 0, 0))
        episode = make_episode(sim)
        episode.ride_command = torch.tensor([[1.0, speed, curvature]])
        assert float(term(sim, episode, context)) == pytest.approx(expected, abs=1e-4)
        episode.ride_command = torch.zeros(1, 3)
        assert float(term(sim, episode, context)) == 0.0
