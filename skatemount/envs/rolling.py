"""The rolling resistance of a board's wheels, which grows with the load on them."""

from __future__ import annotations

from typing import Protocol

import mujoco
import torch
from torch import Tensor

from skatemount.envs.scene import SceneIndex
from skatemount.envs.state import SimState


class ModelFields(Protocol):
    """Worlds with model fields of their own."""

    def field(self, name: str) -> Tensor:
        """Return the ``[N, ...]`` values of a field; writes change the worlds."""
        ...


class RollingResistance:
    """Dry friction of the wheels' joints, M = M0 + c r F / 4.

    M0 is the friction of a wheel's bearing, c the setting ``board.rolling_resistance``, r the wheel's radius, and F the
    load on the four wheels: the board's nominal weight and the vertical force of the feet on the deck. A wheel that
    rolls brakes the board by M / r, so all wheels together brake it by c F.

    MuJoCo's joint friction is a constraint, which holds a wheel at rest without chatter, but does not depend on the
    load. So it is computed from the last state, before each control step. MuJoCo's rolling friction of a contact
    (``condim=6``) depends on the load, but makes a physics step half as long again. If a robot lies on the deck, only
    the load of its feet counts.

    Args:
        coefficient: The setting ``board.rolling_resistance``.
        model: The compiled scene with the nominal values.
        index: Ids of the scene.
        device: Device of the worlds; the CPU if None.
        board_mass: ``[N]`` nominal mass of each world's board, kg, on that device; None if all have the model's.

    Attributes:
        active: True if the resistance depends on the load.
        viscous: Viscous part of the bearings' resistance, N s/m.
    """

    def __init__(
        self,
        coefficient: float,
        model: mujoco.MjModel,
        index: SceneIndex,
        device: torch.device | None = None,
        board_mass: Tensor | None = None,
    ):
        self.active = coefficient > 0
        wheels = index.board_dof[-4:]
        # At 1 m/s the wheels turn at 1 / r.
        per_radius = index.rolling[wheels]
        self._wheels = torch.as_tensor(wheels, device=device)
        self._per_radius = torch.as_tensor(per_radius, dtype=torch.float32, device=device)
        self._bearings = torch.as_tensor(model.dof_frictionloss[wheels], dtype=torch.float32, device=device)
        self._radius = 1 / self._per_radius
        self._coefficient = coefficient
        mass = model.body_subtreemass[index.board_body] if board_mass is None else board_mass.float()
        weight = -mass * float(model.opt.gravity[2])
        self._weight = weight if isinstance(weight, Tensor) else float(weight)
        self.viscous = float(model.dof_damping[wheels] @ per_radius**2)

    def restart(self, worlds: ModelFields, rows: Tensor) -> None:
        """Leave the bearings' friction only, so that a start state does not depend on the last episode.

        Args:
            worlds: The worlds.
            rows: ``[K]`` int64, the worlds that are reset.
        """
        friction = worlds.field("dof_frictionloss")
        friction[rows.unsqueeze(1), self._wheels] = self._bearings.to(friction)

    def joint_friction(self, sim: SimState) -> Tensor:
        """Compute the dry friction of each wheel's joint, ``[N, 4]`` N m."""
        # The sensors give the force on the deck, which points down.
        load = (self._weight - sim.foot_deck_force[..., 2].sum(1)).clamp(min=0.0)
        return self._bearings + self._coefficient / 4 * load.unsqueeze(1) * self._radius

    def dry(self, sim: SimState) -> Tensor:
        """Compute the dry part of the resistance of all wheels together, ``[N]`` N."""
        return self.joint_friction(sim) @ self._per_radius

    def apply(self, worlds: ModelFields, sim: SimState) -> None:
        """Write the friction for the next control step into the worlds.

        Args:
            worlds: The worlds.
            sim: Their ``[N]`` states.
        """
        friction = worlds.field("dof_frictionloss")
        friction[:, self._wheels] = self.joint_friction(sim).to(friction)
