"""A force that keeps a rolling board rolling."""

from __future__ import annotations

import torch
from torch import Tensor

from skatemount.envs.rolling import RollingResistance
from skatemount.envs.state import SimState

MIN_SPEED = 0.05
"""Speed below which a board is not driven, m/s, so that dry friction holds a board at rest."""


class Drive:
    """A force along a free board's heading that balances its rolling resistance, so that it keeps its speed.

    On the deck's body acts F = sign(v) (A + B |v|) along the horizontal heading, with v the speed of the deck along it
    and A and B the dry and the viscous part of its `RollingResistance`. F is 0 for a fixed board, and for |v| below
    `MIN_SPEED`. It is computed at the start of each control step. It balances losses of the wheels only: what the robot
    or a slipping wheel takes from the speed, it does not give back.

    Args:
        active: The setting ``start.drive``.
        resistance: The rolling resistance of the board.

    Attributes:
        active: True if boards are driven.
    """

    def __init__(self, active: bool, resistance: RollingResistance):
        self.active = active
        self._resistance = resistance

    def force(self, sim: SimState) -> Tensor:
        """Compute the force on the board.

        Args:
            sim: ``[N]`` states.

        Returns:
            ``[N, 3]`` N, world axes.
        """
        heading = sim.board_rot[..., 0].clone()
        heading[:, 2] = 0.0
        heading = torch.nn.functional.normalize(heading, dim=1)
        speed = (sim.board_lin_vel * heading).sum(1)
        size = speed.sign() * (self._resistance.dry(sim) + self._resistance.viscous * speed.abs())
        driven = (speed.abs() >= MIN_SPEED) & ~sim.board_fixed
        return torch.where(driven, size, 0.0).unsqueeze(1) * heading
