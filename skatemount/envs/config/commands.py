"""Settings of velocity commands."""

from __future__ import annotations

from dataclasses import dataclass, field

from skatemount.utils.bounds import check_bounds, interval, number
from skatemount.utils.classes import ClassRegistry
from skatemount.utils.errors import ConfigError

MODES = ("sampled", "board", "zero", "ride")

COMMANDS = ClassRegistry(
    "command", {}, methods=("update",), base="skatemount.envs.commands.CommandGenerator", reserved=MODES
)
"""Commands of plugins by ``command.mode``: classes with the constructor and the `update` of `CommandGenerator`."""

ENDS = ("nearer", "front")
POINTS = ("deck", "ground")


@dataclass
class CommandConfig:
    """Settings of the velocity commands.

    Attributes:
        mode: ``sampled`` from the ranges, ``board`` (toward the board, see `skatemount.envs.commands.toward_board`),
            ``ride`` (as ``board``, and speed and curvature of the board's path while the robot rides, see
            `skatemount.envs.riding`), ``zero``, the name of a plugin's, or ``module:Class`` of your own.
        turn_to: End of the board to turn to when commanded toward it: the ``nearer`` end, or its ``front`` (paper).
        board_point: Point of the board that the command leads to: the center of the ``deck``'s top, or the point on the
            ``ground`` below it (paper). They differ where the board or the robot leans.
        forward: Range of the forward velocity, m/s.
        left: Range of the velocity to the left, m/s.
        turn: Range of the turning rate, rad/s.
        resample: Time between two sampled commands, s.
        standing: Fraction of sampled commands that are zero; with ``mode: ride``, of those that go straight.
        deadband: Horizontal speed below which a sampled velocity is set to zero, m/s.
        speed: Range of the speed of a ride, along the board toward the end that the trunk faces, m/s.
        curvature: Range of the curvature of a ride, as a share of the largest one that the board's trucks allow;
            positive to the left.
        ride_after: Time that the robot must have been mounted before it is commanded to ride, s; 0 for the whole
            episode.
    """

    mode: str
    turn_to: str
    board_point: str
    forward: list[float] = field(metadata=interval(-20, 20, "m/s"))
    left: list[float] = field(metadata=interval(-20, 20, "m/s"))
    turn: list[float] = field(metadata=interval(-50, 50, "rad/s"))
    resample: float = field(metadata=number(0, 3600, "s", above=True))
    standing: float = field(metadata=number(0, 1))
    deadband: float = field(metadata=number(0, 20, "m/s"))
    speed: list[float] = field(metadata=interval(0, 20, "m/s"))
    curvature: list[float] = field(metadata=interval(-1, 1))
    ride_after: float = field(metadata=number(0, 3600, "s"))

    def validate(self, where: str = "command") -> None:
        """Raise `ConfigError` for settings that cannot be used."""
        COMMANDS.check_name(self.mode, f"{where}.mode")
        if self.turn_to not in ENDS:
            raise ConfigError(f"{where}.turn_to={self.turn_to} must be one of {', '.join(ENDS)}")
        if self.board_point not in POINTS:
            raise ConfigError(f"{where}.board_point={self.board_point} must be one of {', '.join(POINTS)}")
        check_bounds(self, where)
