"""Randomized physics for each world, and random pushes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Protocol

import mujoco
import torch
from torch import Tensor

from skatemount.envs.config.randomization import RandomizationConfig
from skatemount.envs.entities.quadruped import KD_INDEX, KP_INDEX, scale_gains, scale_torque_limit
from skatemount.envs.sampling import uniform
from skatemount.envs.scene import SceneIndex

_FACTOR_1 = [1.0, 1.0]
_NOTHING_ADDED = [0.0, 0.0]


class ModelFields(Protocol):
    """Worlds with model fields of their own."""

    def field(self, name: str) -> Tensor:
        """Return the ``[N, ...]`` values of a field; writes change the worlds."""
        ...

    def refresh_constants(self) -> None:
        """Recompute the model constants that depend on masses and inertias."""
        ...


class Randomizer:
    """Draws randomized physics and writes it to the worlds.

    Args:
        config: Ranges of the random values.
        index: Ids of the scene.
        model: The compiled scene with the nominal values.
        generator: Source of randomness.
        of_boards: ``[N, ...]`` nominal values of the fields that differ from board to board, by name; None if all
            worlds have the same board.
    """

    def __init__(
        self,
        config: RandomizationConfig,
        index: SceneIndex,
        model: mujoco.MjModel,
        generator: torch.Generator,
        of_boards: Mapping[str, Tensor] | None = None,
    ):
        config.validate()
        self.config = config
        self._index = index
        self._model = model
        self._of_boards = of_boards or {}
        self._generator = generator

    def _uniform(self, bounds: list[float], of: Tensor, *shape: int) -> Tensor:
        """Draw ``[N, *shape]`` uniform random numbers, one set for each row of a field."""
        return uniform((len(of), *shape), self._generator, bounds, torch.float64).to(of.dtype)

    def _log_uniform(self, bounds: list[float], of: Tensor) -> Tensor:
        """Draw ``[N, 1]`` log-uniform random numbers, one for each row of a field."""
        return torch.exp(self._uniform([math.log(b) for b in bounds], of, 1))

    def _field(self, physics: ModelFields, name: str) -> tuple[Tensor, Tensor]:
        """Return a field of every world, ``[N, ...]``, and its nominal value, ``[1, ...]`` or ``[N, ...]``."""
        values = physics.field(name)
        if name in self._of_boards:
            return values, self._of_boards[name].to(values)
        return values, torch.from_numpy(getattr(self._model, name)).unsqueeze(0).to(values)

    def build_worlds(self, physics: ModelFields) -> None:
        """Draw the values that a world keeps: friction, masses, inertias and the stiffness of the trucks.

        Args:
            physics: The worlds.
        """
        c, index = self.config, self._index
        if c.friction != _FACTOR_1:
            friction, nominal = self._field(physics, "geom_friction")
            geoms = index.touched_geoms
            friction[:, geoms, 0] = nominal[:, geoms, 0] * self._uniform(c.friction, friction, 1)
        if c.truck_stiffness != _FACTOR_1:
            stiffness, nominal = self._field(physics, "jnt_stiffness")
            trucks = index.truck_joints
            stiffness[:, trucks] = nominal[:, trucks] * self._uniform(c.truck_stiffness, stiffness, 1)
        changed = False
        if c.trunk_mass != _NOTHING_ADDED or c.board_mass != _FACTOR_1:
            mass, nominal = self._field(physics, "body_mass")
            board = self._uniform(c.board_mass, mass)
            trunk, deck = index.trunk_body, index.board_body
            mass[:, trunk] = (nominal[:, trunk] + self._uniform(c.trunk_mass, mass)).clamp(min=0.5)
            mass[:, deck] = nominal[:, deck] * board
            inertia, nominal_inertia = self._field(physics, "body_inertia")
            inertia[:, deck] = nominal_inertia[:, deck] * board.unsqueeze(-1)
            changed = True
        if c.inertia != _FACTOR_1:
            inertia, nominal = self._field(physics, "body_inertia")
            bodies = index.robot_bodies
            factor = self._uniform(c.inertia, inertia, len(bodies), 1)
            inertia[:, bodies] = nominal[:, bodies] * factor
            changed = True
        if c.trunk_com != _NOTHING_ADDED:
            com, nominal = self._field(physics, "body_ipos")
            trunk = index.trunk_body
            com[:, trunk] = nominal[:, trunk] + self._uniform(c.trunk_com, com, 3)
            changed = True
        if changed:
            physics.refresh_constants()

    def new_episodes(self, physics: ModelFields, rows: Tensor) -> None:
        """Draw the values that change with each episode: the gains of the motors and their torque limit.

        Args:
            physics: The worlds.
            rows: ``[K]`` int64, the worlds that are reset.
        """
        c = self.config
        gains_vary = c.kp != _FACTOR_1 or c.kd != _FACTOR_1
        if not gains_vary and c.torque_limit == _FACTOR_1:
            return
        field, nominal = self._field(physics, "actuator_gainprm")
        motors = nominal.expand(len(rows), -1, -1)
        if gains_vary:
            kp, kd = self._log_uniform(c.kp, motors), self._log_uniform(c.kd, motors)
            motors = scale_gains(motors, kp, kd)
        if c.torque_limit != _FACTOR_1:
            limits, nominal = self._field(physics, "actuator_forcerange")
            factor = self._log_uniform(c.torque_limit, motors)
            motors, limits[rows] = scale_torque_limit(motors, nominal.expand(len(rows), -1, -1), factor)
        field[rows] = motors

    def dynamics(self, physics: ModelFields, rows: Tensor) -> Tensor:
        """Return the physics of some worlds that no sensor of the robot measures.

        Args:
            physics: The worlds.
            rows: ``[K]`` int64.

        Returns:
            ``[K, 8]`` float32: factor of the friction; mass added to the trunk, kg; mass of the deck, kg; stiffness of
            the trucks, N m/rad; factors of the position gain, the velocity gain and the torque limit; delay of the
            targets, s.
        """
        c, index, motor = self.config, self._index, int(self._index.actuators[0])

        def entry(varies: bool, name: str, *at: int) -> tuple[Tensor, Tensor]:
            """Return an entry of a field in these worlds, ``[K]``, and its nominal value."""
            nominal = torch.tensor(getattr(self._model, name)[at], dtype=torch.float32, device=rows.device)
            # Asking an engine for a field gives every world its own, which takes memory.
            if varies or name in self._of_boards:
                values = physics.field(name)[rows]
                for i in at:
                    values = values.select(1, i)
                return values.float(), nominal
            return nominal.expand(len(rows)), nominal

        masses_vary = c.trunk_mass != _NOTHING_ADDED or c.board_mass != _FACTOR_1
        gains_vary = c.kp != _FACTOR_1 or c.kd != _FACTOR_1 or c.torque_limit != _FACTOR_1
        friction, usual_friction = entry(c.friction != _FACTOR_1, "geom_friction", int(index.touched_geoms[0]), 0)
        trunk, usual_trunk = entry(masses_vary, "body_mass", index.trunk_body)
        deck, _ = entry(masses_vary, "body_mass", index.board_body)
        trucks, _ = entry(c.truck_stiffness != _FACTOR_1, "jnt_stiffness", int(index.truck_joints[0]))
        kp, usual_kp = entry(gains_vary, "actuator_gainprm", motor, KP_INDEX)
        kd, usual_kd = entry(gains_vary, "actuator_gainprm", motor, KD_INDEX)
        limit, usual_limit = entry(c.torque_limit != _FACTOR_1, "actuator_forcerange", motor, 1)
        delay, _ = entry(bool(self._model.nhistory), "actuator_delay", motor)
        columns = [friction / usual_friction, trunk - usual_trunk, deck, trucks]
        columns += [kp / usual_kp, kd / usual_kd, limit / usual_limit, delay]
        return torch.stack(columns, 1)


class Pushes:
    """Sudden changes of the trunk's velocity at random intervals.

    Args:
        config: Ranges of intervals and velocities.
        num_worlds: Number of worlds.
        control_step: Time between two actions, s.
        generator: Source of randomness.
    """

    def __init__(self, config: RandomizationConfig, num_worlds: int, control_step: float, generator: torch.Generator):
        self.config = config
        self._step = control_step
        self._generator = generator
        self._time_left = self._intervals(num_worlds)

    @property
    def active(self) -> bool:
        """True if the settings ask for pushes."""
        return self.config.push_interval is not None and self.config.push_velocity != _NOTHING_ADDED

    def _intervals(self, n: int) -> Tensor:
        return uniform((n,), self._generator, self.config.push_interval or (1e9, 1e9))

    def due(self) -> tuple[Tensor, Tensor]:
        """Advance by a control step.

        Returns:
            ``[N]`` bool, the worlds to push now, and ``[N, 3]``, the change of the trunk's velocity, world axes, m/s.
        """
        n = len(self._time_left)
        self._time_left -= self._step
        due = self._time_left <= 0
        self._time_left = torch.where(due, self._intervals(n), self._time_left)
        velocity = uniform((n, 3), self._generator, self.config.push_velocity)
        velocity[:, 2] = 0.0
        return due, velocity

    def restart(self, mask: Tensor) -> None:
        """Draw new intervals for the worlds that are reset.

        Args:
            mask: ``[N]`` bool.
        """
        self._time_left = torch.where(mask, self._intervals(len(mask)), self._time_left)

    def state_dict(self) -> dict[str, Tensor]:
        """Return a copy of the times left until the next pushes."""
        return {"time_left": self._time_left.clone()}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restore what `state_dict` returned."""
        self._time_left = state["time_left"].to(self._time_left)
