"""Settings of the solver and of the physics engine."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from skatemount.utils.bounds import check_bounds, interval, number
from skatemount.utils.errors import ConfigError

ELLIPTIC_LS_ITERATIONS = 50
"""Smallest number of line-search iterations with which elliptic cones converge; with 10, a trained policy fails."""
ENGINES = ("cpu", "warp")
_DEVICE = re.compile(r"auto|cpu|cuda(:\d{1,2})?")


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
        foot_impedance: Impedance of the feet's contacts at no depth and at a depth of 1 mm, the first two numbers of
            MuJoCo's ``solimp``. With MuJoCo's default, [0.9, 0.95], loaded feet creep.
    """

    timestep: float = field(metadata=number(0.0001, 0.02, "s"))
    substeps: int = field(metadata=number(1, 1000))
    solver: str
    iterations: int = field(metadata=number(1, 1000))
    ls_iterations: int = field(metadata=number(1, 1000))
    tolerance: float = field(metadata=number(0, 1))
    cone: str
    impratio: float = field(metadata=number(0, 1000, above=True))
    foot_impedance: list[float] = field(metadata=interval(0.0001, 0.9999))

    @property
    def control_step(self) -> float:
        """Time between two actions, s."""
        return self.timestep * self.substeps

    def validate(self, where: str = "physics") -> None:
        """Raise `ConfigError` if a setting cannot be used; ``where`` names the group in the message."""
        check_bounds(self, where)
        for name, known in (("solver", ("Newton", "CG", "PGS")), ("cone", ("pyramidal", "elliptic"))):
            if getattr(self, name) not in known:
                raise ConfigError(f"{where}.{name}={getattr(self, name)} must be one of {', '.join(known)}")
        if self.cone == "elliptic" and self.ls_iterations < ELLIPTIC_LS_ITERATIONS:
            raise ConfigError(
                f"{where}.cone=elliptic needs {where}.ls_iterations of at least {ELLIPTIC_LS_ITERATIONS}, not "
                f"{self.ls_iterations}"
            )


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
    num_worlds: int = field(metadata=number(1, 1_000_000))
    threads: int = field(metadata=number(1, 1024, zero="every core"))
    device: str
    max_contacts: int = field(metadata=number(1, 10_000))
    max_constraints: int = field(metadata=number(1, 10_000))

    def validate(self, where: str = "physics") -> None:
        """Raise `ConfigError` if a setting cannot be used; ``where`` names the group in the message."""
        super().validate(where)
        if self.engine not in ENGINES:
            raise ConfigError(f"{where}.engine={self.engine} must be one of {', '.join(ENGINES)}")
        if not _DEVICE.fullmatch(self.device):
            raise ConfigError(f"{where}.device={self.device} must be auto, cpu, cuda or cuda:<number>")
