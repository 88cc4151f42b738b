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
