"""Rewards for riding: following the commanded path by leaning the board.

Every function returns ``[N]``, without its weight; 0 while no ride is commanded. "Ours" means a term that is not in the
paper.
"""

from __future__ import annotations

import torch
from torch import Tensor

from skatemount.envs import riding
from skatemount.envs.rewards.table import reward
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.terms import TaskContext

GRAVITY = 9.81
"""m/s^2, MuJoCo's default."""


@reward
def ride_yaw_rate(sim: SimState, episode: EpisodeState, context: TaskContext, sigma: float = 0.12) -> Tensor:
    """Reward the commanded turning rate of the board: exp(-((omega - kappa* v) / sigma)^2) during a ride (ours).

    omega is the board's turning rate, v its speed toward the end that the trunk faces, and kappa* the commanded
    curvature.

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        sigma: Error at which the value falls to 1/e, rad/s.
    """
    error = riding.yaw_rate_error(sim, episode)
    return torch.exp(-(error / sigma).square()) * _phase(sim, episode)


@reward
def ride_lean(sim: SimState, episode: EpisodeState, context: TaskContext, sigma: float = 0.03) -> Tensor:
    """Reward the lean that the commanded curvature needs: exp(-((lean - gamma) / sigma)^2) during a ride.

    gamma = asin(L kappa* tan(theta) / 2), see `skatemount.envs.riding.lean_of_curvature`. HUSKY (arXiv 2602.03205) has
    a term of this kind.

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        sigma: Error at which the value falls to 1/e, rad.
    """
    if (command := episode.ride_command) is None:
        return _phase(sim, episode)
    target = riding.lean_of_curvature(command[:, 2], sim, context)
    return torch.exp(-((riding.lean_left(sim, episode) - target) / sigma).square()) * command[:, 0]


@reward
def ride_shift(
    sim: SimState,
    episode: EpisodeState,
    context: TaskContext,
    sigma: float = 0.02,
    stiffness: float = 0.65,
    height: float = 0.36,
) -> Tensor:
    """Reward a trunk that is shifted as the commanded lean needs: exp(-((y - s) / sigma)^2) during a ride (ours).

    y is the place of the trunk's center across the deck, and s = gamma (K / (m g) - h + v^2 h / (g L)) the shift at
    which the board leans by gamma: the balance of torques about the board's roll axis, with L the steering length. A
    trunk shifts faster than a board turns, so this term shows the policy sooner than the others what is better.

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        sigma: Error at which the value falls to 1/e, m.
        stiffness: K / (m g), the roll stiffness of both trucks over the robot's weight, m. The default is that of
            ``robot=a1`` on ``board=default``.
        height: h, the height of the robot's center of mass over the board's roll axis, m.
    """
    if (command := episode.ride_command) is None:
        return _phase(sim, episode)
    length, _ = context.steering_of(sim)
    lever = stiffness - height + riding.forward_speed(sim, episode).square() * height / (GRAVITY * length)
    shift = lever * riding.lean_of_curvature(command[:, 2], sim, context)
    place = ((sim.base_pos - sim.board_pos) * sim.board_rot[:, :, 1]).sum(1) * episode.board_direction[:, 0]
    return torch.exp(-((place - shift) / sigma).square()) * command[:, 0]


def _phase(sim: SimState, episode: EpisodeState) -> Tensor:
    """Return 1 during a ride, else 0, ``[N]``."""
    return torch.zeros_like(sim.ground_height) if episode.ride_command is None else episode.ride_command[:, 0]
