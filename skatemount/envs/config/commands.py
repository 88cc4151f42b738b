"""Settings of velocity commands."""

from __future__ import annotations

import math
from dataclasses import dataclass

from skatemount.utils.classes import ClassRegistry
from skatemount.utils.errors import ConfigError, check_range

MODES = ("sampled", "board", "zero")

COMMANDS = ClassRegistry(
    "command", {}, methods=("update",), base="skatemount.envs.commands.CommandGenerator", reserved=MODES
)
"""Commands of plugins by ``command.mode``: classes with the constructor and the `update` of `CommandGenerator`."""

ENDS = ("nearer", "front")


@dataclass
class CommandConfig:
    """Settings of the velocity commands.

    Attributes:
        mode: ``sampled`` from the ranges, ``board`` (toward the board, see `skatemount.envs.commands.toward_board`),
            ``zero``, the name of a plugin's, or ``module:Class`` of your own.
        turn_to: End of the board to turn to when commanded toward it: the ``nearer`` end, or its ``front`` (paper).
        forward: Range of the forward velocity, m/s.
        left: Range of the velocity to the left, m/s.
        turn: Range of the turning rate, rad/s.
        resample: Time between two sampled commands, s.
        standing: Fraction of sampled commands that are zero.
        deadband: Horizontal speed below which a sampled velocity is set to zero, m/s.
    """

    mode: str
    turn_to: str
    forward: list[float]
    left: list[float]
    turn: list[float]
    resample: float
    standing: float
    deadband: float

    def validate(self, where: str = "command") -> None:
        """Raise `ConfigError` for settings that cannot be used."""
        COMMANDS.check_name(self.mode, f"{where}.mode")
        if self.turn_to not in ENDS:
            raise ConfigError(f"{where}.turn_to={self.turn_to} must be one of {', '.join(ENDS)}")
        for name in ("forward", "left", "turn"):
            check_range(f"{where}.{name}", getattr(self, name))
        if not 0 < self.resample < math.inf:
            raise ConfigError(f"{where}.resample={self.resample} must be above 0 s and finite")
        if not 0 <= self.standing <= 1:
            raise ConfigError(f"{where}.standing={self.standing} must be a fraction between 0 and 1")
        if not self.deadband >= 0:
            raise ConfigError(f"{where}.deadband={self.deadband} must be 0 or more, in m/s")
