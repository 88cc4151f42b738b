"""Settings of the solver and of the physics engine."""

from __future__ import annotations

from dataclasses import dataclass

from skatemount.utils.errors import ConfigError

ENGINES = ("cpu", "warp")


@dataclass
class SolverConfig:
    """Time stepping and MuJoCo solver settings.

    Attributes:
        timestep: Length of a physics step, s.
        substeps: Number of physics steps in a control step.
        solver: MuJoCo's constraint solver: ``Newton``, ``CG`` or ``PGS``.
        iterations: Largest number of solver iterations.
        ls_iterations: Largest number of line-search iterations.
        tolerance: Improvement below which the solver stops early; mujoco_warp raises it to at least 1e-6.
        cone: Friction cone, ``pyramidal`` or ``elliptic``.
        impratio: Ratio of frictional to normal constraint impedance.
    """

    timestep: float
    substeps: int
    solver: str
    iterations: int
    ls_iterations: int
    tolerance: float
    cone: str
    impratio: float

    @property
    def control_step(self) -> float:
        """Time between two actions, s."""
        return self.timestep * self.substeps

    def validate(self, where: str = "physics") -> None:
        """Raise `ConfigError` if a setting cannot be used; ``where`` names the group in the message."""
        if not 1e-4 <= self.timestep <= 0.02:
            raise ConfigError(f"{where}.timestep={self.timestep} must be from 0.0001 to 0.02 s")
        if not 0 <= self.tolerance <= 1:
            raise ConfigError(f"{where}.tolerance={self.tolerance} must be within 0 and 1")
        if not 0 < self.impratio <= 1000:
            raise ConfigError(f"{where}.impratio={self.impratio} must be above 0 and at most 1000")
        for name in ("substeps", "iterations", "ls_iterations"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{where}.{name}={getattr(self, name)} must be at least 1")
        for name, known in (("solver", ("Newton", "CG", "PGS")), ("cone", ("pyramidal", "elliptic"))):
            if getattr(self, name) not in known:
                raise ConfigError(f"{where}.{name}={getattr(self, name)} must be one of {', '.join(known)}")


@dataclass
class PhysicsConfig(SolverConfig):
    """Settings of the physics engine and its worlds.

    Attributes:
        engine: ``cpu`` (`mujoco.batch` on threads) or ``warp`` (mujoco_warp, for a GPU).
        num_worlds: Number of worlds that are stepped together.
        threads: Number of physics threads of ``cpu``; 0 takes every core.
        device: Device of ``warp``: ``auto`` (a GPU if there is one, else the CPU), ``cuda``, ``cuda:1`` or ``cpu``.
        max_contacts: Memory of ``warp`` for contacts, per world on average. A contact sensor adds up at most a third as
            many.
        max_constraints: Memory of ``warp`` for constraint rows, per world.
    """

    engine: str
    num_worlds: int
    threads: int
    device: str
    max_contacts: int
    max_constraints: int

    def validate(self, where: str = "physics") -> None:
        """Raise `ConfigError` if a setting cannot be used; ``where`` names the group in the message."""
        super().validate(where)
        if self.engine not in ENGINES:
            raise ConfigError(f"{where}.engine={self.engine} must be one of {', '.join(ENGINES)}")
        for name in ("num_worlds", "max_contacts", "max_constraints"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{where}.{name}={getattr(self, name)} must be at least 1")
        if self.threads < 0:
            raise ConfigError(f"{where}.threads={self.threads} must be 0 (every core) or more")
