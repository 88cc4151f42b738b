"""What counts as standing on the board: MountBench's definition, used by rewards, training and evaluation alike."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from skatemount.envs.config.task import HOLD
from skatemount.envs.geometry import beyond_rectangle
from skatemount.envs.state import EpisodeState, SimState

PRESS = 1.0
"""Contact force that counts as a contact, N."""
FLICKER = 0.1
"""How long a foot's contact with the deck may be interrupted, s."""
MAX_VELOCITY_ERROR = 0.25
"""Mean error of the velocity in the plane that still counts as following the command, m/s."""
MAX_TURN_ERROR = 0.3
"""Likewise of the turning rate, rad/s."""
MAX_TRUNK_TILT = math.radians(45)
MAX_DECK_TILT = math.radians(30)


def feet_on_deck(sim: SimState) -> Tensor:
    """Which feet press on the deck from above, ``[N, 4]`` bool.

    The contact force with the deck exceeds 1 N and the foot's centre is above the deck's plane.
    """
    force = torch.linalg.vector_norm(sim.foot_deck_force, dim=-1)
    return (force > PRESS) & (sim.foot_pos_board[..., 2] > 0.0)


def feet_elsewhere(sim: SimState) -> Tensor:
    """Which feet press on anything that is not the deck, ``[N, 4]`` bool."""
    return torch.linalg.vector_norm(sim.foot_other_force, dim=-1) > PRESS


def body_contacts(sim: SimState) -> Tensor:
    """Which other parts of the robot touch board or ground, ``[N, 13]`` bool."""
    return sim.body_force > PRESS


def deck_level(sim: SimState) -> Tensor:
    """Cosine of the angle between the deck's normal and the vertical, ``[N]``."""
    return sim.board_rot[:, 2, 2]


def is_mounted(sim: SimState, off_time: Tensor, elsewhere: Tensor) -> Tensor:
    """Whether the robot stands on the board now, ``[N]`` bool.

    All four feet on the deck (each interrupted for at most 0.1 s), no foot on anything else, no other part of the
    robot in contact, trunk within 45 degrees of upright, deck within 30 degrees of level.

    Args:
        sim: The state.
        off_time: ``[N, 4]`` seconds since each foot last pressed on the deck.
        elsewhere: ``[N]`` bool, whether any of the `feet_elsewhere` is.
    """
    # A millisecond forgives float32's rounding of a sum of control steps.
    feet = (off_time <= FLICKER + 1e-3).all(-1) & ~elsewhere
    clean = ~body_contacts(sim).any(-1)
    level = (-sim.gravity[:, 2] > math.cos(MAX_TRUNK_TILT)) & (deck_level(sim) > math.cos(MAX_DECK_TILT))
    return feet & clean & level


def nearly_mounted(sim: SimState, elsewhere: Tensor, deck_half: tuple[float, float], foot_radius: float) -> Tensor:
    """Share of the feet over the deck and at most 2 cm above it, 0 with a foot elsewhere or tilted, ``[N]``.

    Args:
        sim: The state.
        elsewhere: ``[N]`` bool, whether any of the `feet_elsewhere` is.
        deck_half: Half length and half width of the deck, m.
        foot_radius: m.
    """
    position = sim.foot_pos_board
    beyond_x, beyond_y = beyond_rectangle(position, deck_half)
    height = position[..., 2]
    near = (beyond_x < 0) & (beyond_y < 0) & (height > 0.0) & (height < foot_radius + 0.02)
    sound = ~elsewhere & (-sim.gravity[:, 2] > math.cos(MAX_TRUNK_TILT))
    return near.float().mean(-1) * sound


def stood(episode: EpisodeState, control_step: float) -> Tensor:
    """Whether the robot was mounted throughout the last second, ``[N]`` bool.

    Args:
        episode: The episodes, at their last step.
        control_step: Seconds.
    """
    return episode.mounted_time >= HOLD - control_step / 2


def followed(episode: EpisodeState, control_step: float) -> Tensor:
    """Whether the robot followed its velocity commands, ``[N]`` bool: mean errors below 0.25 m/s and 0.3 rad/s.

    Args:
        episode: The episodes, at their last step.
        control_step: Seconds.
    """
    mean = episode.command_error / episode.step.clamp(min=1).unsqueeze(1)
    return (mean[:, 0] < MAX_VELOCITY_ERROR) & (mean[:, 1] < MAX_TURN_ERROR)


ACHIEVED = {"mount": stood, "gait": followed}
"""What an episode must achieve to succeed, besides lasting until its time limit."""


def time_to_mount(episode: EpisodeState, control_step: float) -> Tensor:
    """Seconds from the first foot-deck contact to the start of the present mounted stretch, ``[N]``.

    Only meaningful for an episode that has succeeded.
    """
    elapsed = episode.step * control_step
    return (elapsed - episode.mounted_time - episode.first_contact).clamp(min=0.0)
