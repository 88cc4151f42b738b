"""Suites of MountBench: fixed, versioned tests, each a file in ``conf/suite/``."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

from skatemount.utils.bounds import check_bounds, number
from skatemount.utils.errors import ConfigError, check_name


@dataclass
class SuiteConfig:
    """A test that is the same for every policy.

    The task is that of a stage, with changes. Robot, observation and control rate are the policy's own. A result is
    quoted with the suite's name and version, so a change of the test raises the version.

    Attributes:
        name: Name of the suite, which is the name of its file.
        version: Number that rises when results are no longer comparable with earlier ones.
        description: One line about it.
        stage: Stage whose task is used.
        overrides: Changes to that task, in Hydra's syntax.
        variants: Further changes by name, for a suite of several tasks; episodes take them in turn.
        ladder: Quantity of which the variants are steps, from easy to hard; empty if they are not. Its results say
            at which step the success rate falls below 90 %.
        unit: Unit of the ladder's steps.
        grid: Two quantities, each with further changes by the name of its step; every pair of steps is a variant. The
            results are shown as a heat map, the first quantity from left to right.
        members: Names of other suites, in place of a stage; each of them is run.
        seed: Seed of worlds and start states, together with the user's seed. Suites with the same seed share both as
            far as their settings allow.
    """

    name: str = ""
    version: int = field(default=1, metadata=number(1, 10**6))
    description: str = ""
    stage: str = ""
    overrides: list[str] = field(default_factory=list)
    variants: dict[str, list[str]] = field(default_factory=dict)
    ladder: str = ""
    unit: str = ""
    grid: dict[str, dict[str, list[str]]] = field(default_factory=dict)
    members: list[str] = field(default_factory=list)
    seed: int = field(default=0, metadata=number(0, 2**62))

    def __post_init__(self) -> None:
        """Make the variants of a grid."""
        if len(self.grid) == 2 and not self.variants:
            across, down = self.grid.values()
            pairs = itertools.product(across.items(), down.items())
            self.variants = {f"{a}, {b}": [*changes, *others] for (a, changes), (b, others) in pairs}

    def validate(self, where: str = "suite") -> None:
        """Raise `ConfigError` for a suite that contradicts itself."""
        if not self.name:
            raise ConfigError(f"{where}.name='' must be the name of the suite's file")
        check_name(f"{where}.name", self.name)
        check_bounds(self, where)
        if bool(self.stage) == bool(self.members):
            raise ConfigError(
                f"{where}.stage={self.stage!r} and {where}.members={self.members}: a suite has one of the two"
            )
        if self.grid and len(self.grid) != 2:
            raise ConfigError(f"{where}.grid={list(self.grid)}: a grid has two quantities, each with its steps")
        if self.grid and self.ladder:
            raise ConfigError(f"{where}.ladder={self.ladder!r}: a suite with a grid is no ladder")
        if self.members and (self.overrides or self.variants):
            raise ConfigError(f"{where}.members={self.members}: such a suite has no overrides or variants of its own")
        if self.ladder and len(self.variants) < 2:
            raise ConfigError(f"{where}.ladder={self.ladder!r}: a ladder needs at least two variants, its steps")
        if self.unit and not self.ladder:
            raise ConfigError(f"{where}.unit={self.unit!r}: only a suite with a ladder has a unit")
