"""Settings of start states."""

from __future__ import annotations

import math
from dataclasses import dataclass

from skatemount.utils.errors import ConfigError, check_range

_MAX_TILT = 0.5


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

    x: list[float]
    y: list[float]
    both_sides: bool
    distance: list[float] | None
    yaw: list[float]
    roll: list[float]
    pitch: list[float]
    height: list[float]
    lin_vel: list[float]
    ang_vel: list[float]
    joint_pos: list[float]
    joint_vel: list[float]
    step_height: list[float] | None
    board_fixed: float
    board_speed: list[float]
    edge_margin: float
    force: list[float]
    torque: list[float]

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
