"""Settings of start states."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from skatemount.utils.errors import ConfigError, check_range

_MAX_TILT = 0.5


def _zero() -> list[float]:
    return [0.0, 0.0]


@dataclass
class StartConfig:
    """Ranges that starts are drawn from, uniformly; each range is ``[low, high]``.

    Attributes:
        x: Trunk forward of the deck's centre, board frame, m.
        y: Trunk left of the deck's centre, m.
        both_sides: Draw the side of ``y`` anew for each start.
        distance: Trunk from the deck's centre in the plane, m, in any direction; instead of ``x`` and ``y`` if given.
        yaw: Heading of the trunk in the board frame, rad.
        roll: Trunk, rad, within 0.5 of upright.
        pitch: Trunk, rad, likewise.
        height: Trunk above where its feet stand, m: the robot is dropped from there.
        lin_vel: Each axis of the trunk's velocity, m/s.
        ang_vel: Each axis of the trunk's angular velocity, rad/s.
        joint_pos: Added to each joint of the stance, rad.
        joint_vel: Each joint, rad/s.
        step_height: Deck above the robot's floor, m; the board's own height if null. Lower steps are made by raising
            the robot's floor.
        board_fixed: Share of the starts with the deck welded to the world, 0 to 1.
        board_speed: Speed at which a free board rolls along its x axis at the start, m/s, in either direction; a fixed
            one is at rest.
        edge_margin: No foot starts nearer to the deck's edge than this, m.
        force: Each axis of a constant force on the trunk for the whole episode, N.
        torque: Each axis of a constant torque on the trunk, N m.
    """

    x: list[float] = field(default_factory=_zero)
    y: list[float] = field(default_factory=_zero)
    both_sides: bool = False
    distance: list[float] | None = None
    yaw: list[float] = field(default_factory=_zero)
    roll: list[float] = field(default_factory=_zero)
    pitch: list[float] = field(default_factory=_zero)
    height: list[float] = field(default_factory=_zero)
    lin_vel: list[float] = field(default_factory=_zero)
    ang_vel: list[float] = field(default_factory=_zero)
    joint_pos: list[float] = field(default_factory=_zero)
    joint_vel: list[float] = field(default_factory=_zero)
    step_height: list[float] | None = None
    board_fixed: float = 1.0
    board_speed: list[float] = field(default_factory=_zero)
    edge_margin: float = 0.02
    force: list[float] = field(default_factory=_zero)
    torque: list[float] = field(default_factory=_zero)

    def validate(self, where: str = "start") -> None:
        """Raise `ConfigError` for ranges that cannot be drawn from."""
        for name, value in vars(self).items():
            if isinstance(value, list):
                check_range(f"{where}.{name}", value)
        if not 0.0 <= self.board_fixed <= 1.0:
            raise ConfigError(f"{where}.board_fixed={self.board_fixed} must be a share between 0 and 1")
        for name in ("roll", "pitch"):
            low, high = getattr(self, name)
            if max(-low, high) > _MAX_TILT:
                raise ConfigError(
                    f"{where}.{name}={[low, high]} must be within -{_MAX_TILT} and {_MAX_TILT} rad: tilted farther the "
                    "robot touches the ground with more than its feet"
                )
        if self.distance is not None and self.distance[0] < 0:
            raise ConfigError(f"{where}.distance={self.distance} must be 0 or more, in metres")
        if self.board_speed[0] < 0:
            raise ConfigError(
                f"{where}.board_speed={self.board_speed} must be 0 or more, in m/s: the direction is drawn besides"
            )
        if self.height[0] < 0:
            raise ConfigError(
                f"{where}.height={self.height} must be 0 or more, in metres: lower would be in the ground"
            )
        if not 0 <= self.edge_margin < math.inf:
            raise ConfigError(f"{where}.edge_margin={self.edge_margin} must be 0 or more and finite, in metres")
