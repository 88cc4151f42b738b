"""Settings of boards that differ from world to world."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from skatemount.envs.config.board import SkateboardConfig
from skatemount.utils.bounds import Bounds, bounds_of, check_bounds, interval, number
from skatemount.utils.errors import ConfigError, brief

RANGES = ("deck_length", "deck_width", "deck_height", "wheelbase", "track", "truck_angle", "truck_stiffness", "mass")
"""Settings of a board that may differ from world to world."""


@dataclass
class BoardsConfig:
    """Ranges ``[low, high]`` from which the board of each world is drawn, uniformly.

    A range that is null leaves the value of ``board``. If every range is null and ``fixed`` is empty, all worlds have
    the one board of the settings. A drawn board that cannot be built, such as one whose wheelbase is longer than its
    deck, is drawn again.

    Attributes:
        deck_length: Length of the flat part of the deck, m.
        deck_width: Width of the deck, m.
        deck_height: Height of the deck's top above the floor, m.
        wheelbase: Distance between the axles, m.
        track: Distance between the centers of a truck's wheels, m.
        truck_angle: Tilt of the trucks' axes from the vertical, degrees.
        truck_stiffness: Stiffness of a truck's bushing, N m/rad.
        mass: Mass of the whole board, kg.
        count: Number of different boards; world i has board i modulo this number, and in an evaluation episode i has.
            0 draws one for each world.
        seed: Seed of the boards; null takes the one of the worlds.
        fixed: Boards in place of drawn ones, each as changes of ``board``, such as ``{mass: 3.0, track: 0.18}``. They
            are used in turn, as with ``count``.
    """

    deck_length: list[float] | None = field(metadata=interval(0.1, 3, "m"))
    deck_width: list[float] | None = field(metadata=interval(0.05, 2, "m"))
    deck_height: list[float] | None = field(metadata=interval(0.01, 1, "m"))
    wheelbase: list[float] | None = field(metadata=interval(0.02, 3, "m"))
    track: list[float] | None = field(metadata=interval(0.01, 2, "m"))
    truck_angle: list[float] | None = field(metadata=interval(5, 85, "degrees from the vertical"))
    truck_stiffness: list[float] | None = field(metadata=interval(0, 10_000, "N m/rad"))
    mass: list[float] | None = field(metadata=interval(0.01, 100, "kg"))
    count: int = field(metadata=number(1, 1_000_000, zero="one for each world"))
    seed: int | None = field(metadata=number(0, 2**62))
    fixed: list[Any]

    @property
    def ranges(self) -> dict[str, list[float]]:
        """The ranges that are not null."""
        return {name: bounds for name in RANGES if (bounds := getattr(self, name)) is not None}

    @property
    def number(self) -> int:
        """Number of different boards; 0 if each world has its own, or all have that of the settings."""
        return len(self.fixed) or self.count

    @property
    def vary(self) -> bool:
        """True if boards differ from world to world."""
        return bool(self.ranges or self.fixed)

    def validate(self, where: str = "boards") -> None:
        """Check the ranges and the fixed boards, each setting for itself.

        Args:
            where: Name of the group, for messages.

        Raises:
            ConfigError: A setting cannot be used.
        """
        check_bounds(self, where)
        if not self.fixed:
            return
        for name in (*self.ranges, *(("count",) if self.count else ())):
            raise ConfigError(
                f"{where}.{name}={getattr(self, name)} with {len(self.fixed)} boards in {where}.fixed: these are not "
                "drawn; leave out one of the two"
            )
        bounds: dict[str, Bounds] = bounds_of(SkateboardConfig)
        for i, changes in enumerate(self.fixed):
            if not isinstance(changes, dict) or not changes:
                raise ConfigError(
                    f"{where}.fixed[{i}]={brief(changes)} must be changes of a board, such as {{mass: 3}}"
                )
            for name, value in changes.items():
                if name not in RANGES:
                    known = ", ".join(RANGES)
                    raise ConfigError(
                        f"{where}.fixed[{i}].{name}={brief(value)} cannot differ from world to world; known: {known}"
                    )
                bounds[name].check(f"{where}.fixed[{i}].{name}", value)

    def validate_with(self, board: SkateboardConfig, where: str = "boards") -> None:
        """Check that the fixed boards can be built.

        Args:
            board: Settings of the board that they are changes of.
            where: Name of the group, for messages.

        Raises:
            ConfigError: One cannot be built.
        """
        for i, changes in enumerate(self.fixed):
            replace(board, **changes).validate(f"{where}.fixed[{i}]")
