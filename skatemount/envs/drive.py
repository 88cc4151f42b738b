"""A force that keeps a rolling board rolling, or brings it to the speed of a ride."""

from __future__ import annotations

import torch
from torch import Tensor

from skatemount.envs.rolling import RollingResistance
from skatemount.envs.state import EpisodeState, SimState

MIN_SPEED = 0.05
"""Speed below which a board is not driven, m/s, so that dry friction holds a board at rest."""
GAIN, MAX_PULL = 30.0, 6.0
"""Pull on a board for each m/s that it is slower than the commanded speed of a ride, N s/m, and the largest pull, N."""


class Drive:
    """A force along a free board's heading that balances its rolling resistance, so that it keeps its speed.

    On the deck's body acts F = sign(v) (A + B |v|) along the horizontal heading, with v the speed of the deck along it
    and A and B the dry and the viscous part of its `RollingResistance`. F is 0 for a fixed board, and for |v| below
    `MIN_SPEED`. It is computed at the start of each control step. It balances losses of the wheels only: what the robot
    or a slipping wheel takes from the speed, it does not give back.

    Where rides are commanded, a board is driven only during one, at any speed, and toward the commanded speed v*:
    ``clamp(GAIN (v* - v), -MAX_PULL, MAX_PULL)`` is added to F. A road that falls by 2.4 degrees pulls a robot and its
    board of 15 kg as strongly as the largest pull.

    Args:
        active: The setting ``start.drive``.
        resistance: The rolling resistance of the board.

    Attributes:
        active: True if boards are driven.
    """

    def __init__(self, active: bool, resistance: RollingResistance):
        self.active = active
        self._resistance = resistance

    def force(self, sim: SimState, episode: EpisodeState | None = None) -> Tensor:
        """Compute the force on the board.

        Args:
            sim: ``[N]`` states.
            episode: Their episodes, for the commands of rides; None if there are none.

        Returns:
            ``[N, 3]`` N, world axes.
        """
        heading = sim.board_rot[..., 0].clone()
        heading[:, 2] = 0.0
        heading = torch.nn.functional.normalize(heading, dim=1)
        speed = (sim.board_lin_vel * heading).sum(1)
        dry, rolls = self._resistance.dry(sim), speed.abs() >= MIN_SPEED
        size = speed.sign() * (dry + self._resistance.viscous * speed.abs())
        driven = rolls & ~sim.board_fixed
        if episode is not None and (command := episode.ride_command) is not None:
            wanted = command[:, 1] * episode.board_direction[:, 0]
            size = torch.where(rolls, size, wanted.sign() * dry)
            size = size + (GAIN * (wanted - speed)).clamp(-MAX_PULL, MAX_PULL)
            driven = (command[:, 0] > 0) & ~sim.board_fixed
        return torch.where(driven, size, 0.0).unsqueeze(1) * heading
