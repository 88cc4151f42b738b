"""Rewards for mounting the board: the paper's five terms, corrected variants of them, and terms of our own.

Every function returns ``[N]``, without its weight. "Paper" means its text, "paper's code" the settings of its published
runs, "ours" a term that is in neither.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from skatemount.envs import success
from skatemount.envs.geometry import beyond_rectangle, rotate_inverse
from skatemount.envs.rewards.table import penalty, reward
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.terms import TaskContext


@reward
def feet_on_board(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Count the feet that press on the deck from above, 0 to 4 (paper)."""
    return episode.on_deck.sum(-1).to(sim.base_pos.dtype)


@reward
def feet_on_board_paper(sim: SimState, episode: EpisodeState, context: TaskContext, height: float = 0.10) -> Tensor:
    """Count the feet that have any force against the deck and are high enough (paper's code).

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        height: Height in the world above which a foot counts, m.
    """
    touching = (sim.foot_deck_force != 0).any(-1)
    return (touching & (sim.foot_pos[..., 2] > height)).sum(-1).to(sim.base_pos.dtype)


@reward
def mounted(sim: SimState, episode: EpisodeState, context: TaskContext, ramp: float = 0.0) -> Tensor:
    """Return 1 while the robot is mounted by the definition of success, else 0 (ours).

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        ramp: Time over which the value grows from 0 to 1 while the robot stays mounted, s. With a ramp, a stance that
            is kept is worth more than one that is left and taken up again. 0 gives the full value at once.
    """
    if ramp <= 0:
        return episode.mounted.to(sim.base_pos.dtype)
    return (episode.mounted_time / ramp).clamp(max=1.0)


@reward
def all_feet_on_board(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return 1 while all four feet press on the deck and none on anything else, else 0 (ours).

    Unlike `mounted`, other parts of the robot may touch something.
    """
    alone = episode.on_deck.all(-1) & ~episode.foot_off_deck_contact
    return alone.to(sim.base_pos.dtype)


@reward
def feet_proximity(
    sim: SimState, episode: EpisodeState, context: TaskContext, scale: float = 0.12, margin: float = 0.02
) -> Tensor:
    """Reward feet near the deck's top: the mean over feet of exp(-d / scale) (ours).

    d is the distance from the sole to the deck's top, of which a margin along the edge is left out. A foot under the
    deck gets the length of the way out to the side and up, because otherwise it would be as good as a foot on the deck.

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        scale: Distance at which the value falls to 1/e, m.
        margin: Distance from the edge that a foot should keep, m.
    """
    position, (half_x, half_y) = sim.foot_pos_board, context.deck_half_of(sim)
    beyond_x, beyond_y = beyond_rectangle(position, (half_x - margin, half_y - margin))
    outside = torch.hypot(beyond_x.clamp(min=0), beyond_y.clamp(min=0))
    height = position[..., 2] - context.foot_radius
    # Distance to the nearest edge, as a positive number, for a foot inside the outline.
    depth = -torch.maximum(beyond_x, beyond_y).clamp(max=0)
    detour = torch.where(height < -context.foot_radius, depth, 0.0)
    return torch.exp(-(outside + detour + height.abs()) / scale).mean(-1)


@reward
def approach(sim: SimState, episode: EpisodeState, context: TaskContext, limit: float = 1.0) -> Tensor:
    """Reward the trunk's horizontal speed toward the deck's center, m/s (ours).

    This is the shaping reward of the potential -d, with d the horizontal distance.

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        limit: Largest absolute value, m/s.
    """
    speed = (episode.previous_distance - episode.distance) / context.control_step
    return speed.clamp(-limit, limit)


@reward
def distance(sim: SimState, episode: EpisodeState, context: TaskContext, scale: float = 0.25) -> Tensor:
    """Reward closeness to the deck: exp(-d / scale), with d the trunk's horizontal distance to its center (paper).

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        scale: Distance at which the value falls to 1/e, m; the default is that of the paper's code.
    """
    return torch.exp(-episode.distance / scale)


@reward
def alignment(
    sim: SimState, episode: EpisodeState, context: TaskContext, gate: float = 0.3, scale: float = 0.25
) -> Tensor:
    """Reward alignment with the board near it: exp(-(|yaw| / pi) / scale) within a gate, with yaw modulo pi.

    This follows the paper's text. Two choices are ours: the gate is a horizontal distance, and either end of the board
    may be its front. See `orientation_paper` for the paper's code.

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        gate: Horizontal distance from the deck's center within which the term counts, m.
        scale: Value of |yaw| / pi at which the term falls to 1/e.
    """
    x_axis = sim.board_rot_base[..., 0]
    yaw = torch.atan2(x_axis[:, 1], x_axis[:, 0]).abs()
    yaw = torch.minimum(yaw, math.pi - yaw)
    return torch.exp(-(yaw / math.pi) / scale) * (episode.distance < gate)


@reward
def orientation_paper(
    sim: SimState, episode: EpisodeState, context: TaskContext, gate: float = 0.3, scale: float = 0.25
) -> Tensor:
    """Reward alignment with the board near it: exp(-(angle / pi) / scale) within a gate (paper's code).

    The angle is that of the whole rotation between trunk and board. The gate is a distance in space from a point on the
    floor, so only a robot that crouches gets through.

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        gate: Distance from the point under the board's center within which the term counts, m.
        scale: Value of angle / pi at which the term falls to 1/e.
    """
    rotation = sim.board_rot_base
    cosine = ((rotation.diagonal(dim1=-2, dim2=-1).sum(-1) - 1) / 2).clamp(-1, 1)
    origin = sim.board_pos_base - context.deck_height_of(sim) * rotation[..., 2]
    near = torch.linalg.vector_norm(origin, dim=-1) < gate
    return torch.exp(-(torch.acos(cosine) / math.pi) / scale) * near


@penalty
def board_flip(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Penalize a board on its back: 1 while its z axis points down, else 0 (paper)."""
    return (sim.board_rot[:, 2, 2] < 0).to(sim.base_pos.dtype)


@penalty
def board_speed(sim: SimState, episode: EpisodeState, context: TaskContext, horizontal: bool = True) -> Tensor:
    """Penalize the speed of the board, m/s.

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        horizontal: True for the horizontal speed (paper), False for the speed in space (paper's code).
    """
    velocity = sim.board_lin_vel[:, :2] if horizontal else sim.board_lin_vel
    return torch.linalg.vector_norm(velocity, dim=-1)


@penalty
def board_tilt(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Penalize a tilted deck: 1 - cos^2 of the angle between its normal and the vertical (ours)."""
    return 1 - success.deck_level(sim).square()


@penalty
def feet_near_edge(
    sim: SimState, episode: EpisodeState, context: TaskContext, half_width: float = 0.08, half_length: float = 0.25
) -> Tensor:
    """Penalize feet near the deck's edge: the sum over feet on the deck of |x| and |y| beyond a rectangle, m (ours).

    A foot outside the wheels' track tips a free board. If boards vary, the rectangle grows with each one's wheelbase
    and track.

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        half_width: Half width of the rectangle, m.
        half_length: Half length of the rectangle, m.
    """
    along, across = context.wheels_scale_of(sim)
    beyond_x, beyond_y = beyond_rectangle(sim.foot_pos_board, (half_length * along, half_width * across))
    return ((beyond_x.clamp(min=0) + beyond_y.clamp(min=0)) * episode.on_deck).sum(-1)


@penalty
def deck_margin(sim: SimState, episode: EpisodeState, context: TaskContext, margin: float = 0.03) -> Tensor:
    """Penalize feet close to the edge of the deck: the sum over feet on the deck of 1 - d / margin, at least 0 (ours).

    d is the distance from the center of the foot to the nearest edge of its own board's deck, m.

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        margin: Distance from the edge at which the penalty begins, m.
    """
    beyond_x, beyond_y = beyond_rectangle(sim.foot_pos_board, context.deck_half_of(sim))
    inside = -torch.maximum(beyond_x, beyond_y)
    return ((1 - inside / margin).clamp(0.0, 1.0) * episode.on_deck).sum(-1)


@penalty
def feet_creep(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Penalize feet that creep on the deck: the sum of their x-y speeds on the board while mounted, m/s (ours).

    With ``physics.foot_impedance=[0.9,0.95]``, MuJoCo's default, a foot that pushes sideways creeps, and slips off the
    deck after some seconds.
    """
    return torch.linalg.vector_norm(sim.foot_vel_board[..., :2], dim=-1).sum(-1) * episode.mounted


@penalty
def still(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Penalize moving on the board: the trunk's x-y speed relative to it, trunk frame, while mounted, m/s (ours)."""
    relative = sim.base_lin_vel - rotate_inverse(sim.base_rot, sim.board_lin_vel)
    return torch.linalg.vector_norm(relative[:, :2], dim=-1) * episode.mounted
