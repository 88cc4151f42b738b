"""Contacts, and what *mounted* means; rewards, tasks, training and evaluation share it."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from skatemount.envs.geometry import beyond_rectangle
from skatemount.envs.state import SimState

PRESS = 1.0
"""Force above which a contact counts, N."""
FLICKER = 0.1
"""Longest interruption of a foot's contact with the deck that is forgiven, s."""
MAX_TRUNK_TILT = math.radians(45)
MAX_DECK_TILT = math.radians(30)


def feet_on_deck(sim: SimState) -> Tensor:
    """Find the feet that press on the deck from above.

    The contact force with the deck exceeds 1 N, and the foot's center is above the deck's plane.

    Args:
        sim: The state.

    Returns:
        ``[N, F]`` bool.
    """
    force = torch.linalg.vector_norm(sim.foot_deck_force, dim=-1)
    return (force > PRESS) & (sim.foot_pos_board[..., 2] > 0.0)


def feet_off_deck_contact(sim: SimState) -> Tensor:
    """Find the feet that press on anything other than the deck, ``[N, F]`` bool."""
    return torch.linalg.vector_norm(sim.foot_other_force, dim=-1) > PRESS


def body_contacts(sim: SimState) -> Tensor:
    """Find the robot bodies other than the feet that touch board or ground, ``[N, B]`` bool."""
    return sim.body_force > PRESS


def deck_level(sim: SimState) -> Tensor:
    """Return the cosine of the angle between the deck's normal and the vertical, ``[N]``."""
    return sim.board_rot[:, 2, 2]


def is_mounted(sim: SimState, off_time: Tensor, off_deck_contact: Tensor) -> Tensor:
    """Test whether the robot is mounted now.

    All four feet are on the deck, each interrupted for at most 0.1 s. No foot presses on anything else, and no other
    part of the robot touches anything. The trunk is within 45 degrees of upright, and the deck within 30 degrees of
    level.

    Args:
        sim: The state.
        off_time: ``[N, F]`` time since each foot last pressed on the deck, s.
        off_deck_contact: ``[N]`` bool, true where a foot presses on anything other than the deck.

    Returns:
        ``[N]`` bool.
    """
    # The millisecond covers float32's rounding of a sum of control steps.
    feet = (off_time <= FLICKER + 1e-3).all(-1) & ~off_deck_contact
    clean = ~body_contacts(sim).any(-1)
    level = (-sim.gravity[:, 2] > math.cos(MAX_TRUNK_TILT)) & (deck_level(sim) > math.cos(MAX_DECK_TILT))
    return feet & clean & level


def nearly_mounted(
    sim: SimState, off_deck_contact: Tensor, deck_half: tuple[float | Tensor, float | Tensor], foot_radius: float
) -> Tensor:
    """Compute the fraction of the feet that are over the deck and at most 2 cm above it.

    Args:
        sim: The state.
        off_deck_contact: ``[N]`` bool, true where a foot presses on anything other than the deck.
        deck_half: Half length and half width of the deck, m; ``[N, 1]`` each if boards vary.
        foot_radius: Radius of a foot, m.

    Returns:
        ``[N]`` from 0 to 1; 0 where a foot presses on anything else or the trunk is tilted by more than 45 degrees.
    """
    position = sim.foot_pos_board
    beyond_x, beyond_y = beyond_rectangle(position, deck_half)
    height = position[..., 2]
    near = (beyond_x < 0) & (beyond_y < 0) & (height > 0.0) & (height < foot_radius + 0.02)
    sound = ~off_deck_contact & (-sim.gravity[:, 2] > math.cos(MAX_TRUNK_TILT))
    return near.float().mean(-1) * sound
