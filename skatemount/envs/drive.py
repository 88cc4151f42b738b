"""A force that keeps a rolling board rolling."""

from __future__ import annotations

import mujoco
import torch
from torch import Tensor

from skatemount.envs.scene import SceneIndex
from skatemount.envs.state import SimState

MIN_SPEED = 0.05
"""Speed below which a board is not driven, m/s, so that dry friction holds a board at rest."""


def rolling_resistance(model: mujoco.MjModel, index: SceneIndex) -> tuple[float, float]:
    """Compute the rolling resistance of a board from the compiled model.

    A wheel of radius r that rolls at the speed v turns at v / r, against the dry friction M (``dof_frictionloss``) and
    the viscous friction b (``dof_damping``) of its joint, MuJoCo's only losses of a sphere that rolls without slip.
    The floor so brakes the board by the sum over wheels of (M + b v / r) / r. It does not depend on the load, because
    joint friction in MuJoCo does not.

    Args:
        model: The compiled scene.
        index: Ids of the scene.

    Returns:
        The dry part, N, and the viscous part, N s/m.
    """
    wheels = index.board_dof[-4:]
    # At 1 m/s the wheels turn at 1 / r.
    per_radius = index.rolling[wheels]
    dry = float(model.dof_frictionloss[wheels] @ per_radius)
    return dry, float(model.dof_damping[wheels] @ per_radius**2)


class Drive:
    """A force along a free board's heading that balances its rolling resistance, so that it keeps its speed.

    On the deck's body acts F = sign(v) (A + B |v|) along the horizontal heading, with v the speed of the deck along it
    and A and B of `rolling_resistance`. F is 0 for a fixed board, and for |v| below `MIN_SPEED`. It is computed at the
    start of each control step. It balances losses of the wheels only: what the robot or a slipping wheel takes from the
    speed, it does not give back.

    Args:
        active: The setting ``start.drive``.
        model: The compiled scene with the nominal values.
        index: Ids of the scene.

    Attributes:
        active: True if boards are driven.
    """

    def __init__(self, active: bool, model: mujoco.MjModel, index: SceneIndex):
        self.active = active
        self._dry, self._viscous = rolling_resistance(model, index)

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
        size = speed.sign() * (self._dry + self._viscous * speed.abs())
        driven = (speed.abs() >= MIN_SPEED) & ~sim.board_fixed
        return torch.where(driven, size, 0.0).unsqueeze(1) * heading
