"""Rewards of the board: the paper's five terms, its sound variants, and what mounting needed besides.

Every function returns ``[N]``, unweighed. "Paper" is its text, "paper's code" the settings of its published runs.
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
    """How many feet press on the deck from above, 0 to 4 (paper: the indicator summed over feet)."""
    return episode.on_deck.sum(-1).to(sim.base_pos.dtype)


@reward
def feet_on_board_paper(sim: SimState, episode: EpisodeState, context: TaskContext, height: float = 0.10) -> Tensor:
    """How many feet have any force against the deck and are higher than 0.10 m in the world (paper's code)."""
    touching = (sim.foot_deck_force != 0).any(-1)
    return (touching & (sim.foot_pos[..., 2] > height)).sum(-1).to(sim.base_pos.dtype)


@reward
def mounted(sim: SimState, episode: EpisodeState, context: TaskContext, ramp: float = 0.0) -> Tensor:
    """1 while all four feet and nothing else are on the deck, by the definition of success (ours).

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        ramp: Seconds over which it grows from 0 to 1 while the robot stands there, s: a stance that is kept is then
            worth more than one that is left and taken up again. 0 gives all of it at once.
    """
    if ramp <= 0:
        return episode.mounted.to(sim.base_pos.dtype)
    return (episode.mounted_time / ramp).clamp(max=1.0)


@reward
def all_feet_on_board(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """1 while all four feet press on the deck and none on anything else (ours; a shin on the deck does not void it)."""
    alone = episode.on_deck.all(-1) & ~episode.foot_off_deck_contact
    return alone.to(sim.base_pos.dtype)


@reward
def feet_proximity(
    sim: SimState, episode: EpisodeState, context: TaskContext, scale: float = 0.12, margin: float = 0.02
) -> Tensor:
    """Mean over feet of exp(-d / scale), d the way left to the deck's top (ours).

    d is the distance from the sole to the deck's top rectangle, less a margin inside the edge; for a foot under the
    deck it is instead the way out to the side and up, otherwise a foot under the deck would be as good as one on it.

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        scale: m.
        margin: How far inside the edge a foot should stand, m.
    """
    position, (half_x, half_y) = sim.foot_pos_board, context.deck_half
    beyond_x, beyond_y = beyond_rectangle(position, (half_x - margin, half_y - margin))
    outside = torch.hypot(beyond_x.clamp(min=0), beyond_y.clamp(min=0))
    height = position[..., 2] - context.foot_radius
    # Out to the nearest edge: how deep the foot is inside the outline, as a positive number.
    depth = -torch.maximum(beyond_x, beyond_y).clamp(max=0)
    detour = torch.where(height < -context.foot_radius, depth, 0.0)
    return torch.exp(-(outside + detour + height.abs()) / scale).mean(-1)


@reward
def approach(sim: SimState, episode: EpisodeState, context: TaskContext, limit: float = 1.0) -> Tensor:
    """Speed toward the deck's centre in the plane, cut at a limit, m/s: what a potential -d yields (ours)."""
    speed = (episode.previous_distance - episode.distance) / context.control_step
    return speed.clamp(-limit, limit)


@reward
def distance(sim: SimState, episode: EpisodeState, context: TaskContext, scale: float = 0.25) -> Tensor:
    """exp(-d_xy / scale), d_xy the trunk's distance from the deck's centre in the plane (paper; its code's scale)."""
    return torch.exp(-episode.distance / scale)


@reward
def alignment(
    sim: SimState, episode: EpisodeState, context: TaskContext, gate: float = 0.3, scale: float = 0.25
) -> Tensor:
    """exp(-(|yaw| / pi) / scale) within ``gate`` metres of the deck's centre in the plane, yaw modulo pi.

    Ours is the paper's text, its distance gate in the plane: a board has no front. See `orientation_paper`.
    """
    x_axis = sim.board_rot_base[..., 0]
    yaw = torch.atan2(x_axis[:, 1], x_axis[:, 0]).abs()
    yaw = torch.minimum(yaw, math.pi - yaw)
    return torch.exp(-(yaw / math.pi) / scale) * (episode.distance < gate)


@reward
def orientation_paper(
    sim: SimState, episode: EpisodeState, context: TaskContext, gate: float = 0.3, scale: float = 0.25
) -> Tensor:
    """exp(-(angle / pi) / scale) within ``gate`` of the point under the board's centre, in space (paper's code).

    The angle is that of the whole rotation between trunk and board, and the point lies on the floor, so the gate is
    open only to a robot that crouches.
    """
    rotation = sim.board_rot_base
    cosine = ((rotation.diagonal(dim1=-2, dim2=-1).sum(-1) - 1) / 2).clamp(-1, 1)
    origin = sim.board_pos_base - context.deck_height * rotation[..., 2]
    near = torch.linalg.vector_norm(origin, dim=-1) < gate
    return torch.exp(-(torch.acos(cosine) / math.pi) / scale) * near


@penalty
def board_flip(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """1 while the board lies on its back: its z axis points down (paper)."""
    return (sim.board_rot[:, 2, 2] < 0).to(sim.base_pos.dtype)


@penalty
def board_speed(sim: SimState, episode: EpisodeState, context: TaskContext, horizontal: bool = True) -> Tensor:
    """Speed of the board, m/s.

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        horizontal: In the plane (paper), or in space (paper's code).
    """
    velocity = sim.board_lin_vel[:, :2] if horizontal else sim.board_lin_vel
    return torch.linalg.vector_norm(velocity, dim=-1)


@penalty
def board_tilt(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """1 - cos^2 of the angle between the deck's normal and the vertical (ours)."""
    return 1 - success.deck_level(sim).square()


@penalty
def feet_near_edge(
    sim: SimState, episode: EpisodeState, context: TaskContext, half_width: float = 0.08, half_length: float = 0.25
) -> Tensor:
    """Sum over feet on the deck of how far they stand outside a safe rectangle, m (ours).

    A foot outside the wheels' track tips a free board.

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        half_width: Of the rectangle, m.
        half_length: Of the rectangle, m.
    """
    beyond_x, beyond_y = beyond_rectangle(sim.foot_pos_board, (half_length, half_width))
    return ((beyond_x.clamp(min=0) + beyond_y.clamp(min=0)) * episode.on_deck).sum(-1)


@penalty
def still(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Speed of the trunk relative to the board in the plane while mounted, m/s (ours)."""
    relative = sim.base_lin_vel - rotate_inverse(sim.base_rot, sim.board_lin_vel)
    return torch.linalg.vector_norm(relative[:, :2], dim=-1) * episode.mounted
