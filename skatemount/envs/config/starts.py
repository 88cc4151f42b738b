"""Settings of start states."""

from __future__ import annotations

import math
from dataclasses import dataclass

from skatemount.utils.errors import ConfigError, check_range

_MAX_TILT = 0.5


@dataclass
class StartConfig:
    """Ranges ``[low, high]`` from which start states are drawn, uniformly.

    Attributes:
        x: Position of the trunk in the board frame, forward of the deck's center, m.
        y: Position of the trunk in the board frame, left of the deck's center, m.
        both_sides: True if the sign of ``y`` is drawn for each start.
        distance: Horizontal distance of the trunk from the deck's center, in any direction, m; null to use ``x`` and
            ``y``.
        yaw: Heading of the trunk in the board frame, rad.
        roll: Roll of the trunk, rad; within 0.5 of upright.
        pitch: Pitch of the trunk, rad; within 0.5 of upright.
        height: Height above the standing pose from which the robot is dropped, m.
        lin_vel: Each axis of the trunk's velocity, m/s.
        ang_vel: Each axis of the trunk's angular velocity, rad/s.
        joint_pos: Offset added to each joint of the stance, rad.
        joint_vel: Velocity of each joint, rad/s.
        step_height: Height of the deck above the robot's floor, m; that of the board if null. The robot's floor is
            raised to make the step lower.
        board_fixed: Fraction of the starts with the deck welded to the world.
        board_speed: Speed at which a free board rolls along its x axis, in a random direction, m/s. A fixed board is at
            rest.
        board_lean: Roll of the deck of a free board about its long axis, rad; positive to the right. It is for robots
            with every foot over the deck, which lean with it; other boards are level. A board that leans and rolls
            turns as its trucks steer.
        truck_angle: Angle of the rear truck about its axis from which the lean follows, in place of ``board_lean``,
            rad; null to use ``board_lean``. The front truck has the opposite angle, so that all wheels stand on the
            floor.
        move_with_board: True if a robot with every foot over the deck begins with the velocity of the board where it
            stands, as if it had been riding; ``lin_vel`` and ``ang_vel`` are added. False if the board rolls under a
            robot at rest.
        drive: True if a force along a free board's heading balances its rolling resistance for the whole episode, so
            that a rolling board keeps its speed; see `skatemount.envs.drive.Drive`.
        edge_margin: Smallest distance of a foot from the deck's edge, m.
        force: Each axis of a constant force on the trunk for the whole episode, N.
        torque: Each axis of a constant torque on the trunk for the whole episode, N m.
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
    board_lean: list[float]
    truck_angle: list[float] | None
    move_with_board: bool
    drive: bool
    edge_margin: float
    force: list[float]
    torque: list[float]

    def validate(self, where: str = "start") -> None:
        """Raise `ConfigError` if a range cannot be drawn from; ``where`` names the group in the message."""
        for name, value in vars(self).items():
            if isinstance(value, list):
                check_range(f"{where}.{name}", value)
        if not 0.0 <= self.board_fixed <= 1.0:
            raise ConfigError(f"{where}.board_fixed={self.board_fixed} must be a fraction between 0 and 1")
        for name in ("roll", "pitch"):
            low, high = getattr(self, name)
            if max(-low, high) > _MAX_TILT:
                raise ConfigError(
                    f"{where}.{name}={[low, high]} must be from -{_MAX_TILT} to {_MAX_TILT} rad; with a larger tilt, "
                    "more than the robot's feet would touch the ground"
                )
        if self.distance is not None and self.distance[0] < 0:
            raise ConfigError(f"{where}.distance={self.distance} must be >= 0 m")
        if self.board_speed[0] < 0:
            raise ConfigError(
                f"{where}.board_speed={self.board_speed} must be >= 0 m/s; the direction is sampled separately"
            )
        if self.truck_angle is not None and self.board_lean != [0.0, 0.0]:
            raise ConfigError(
                f"{where}.truck_angle={self.truck_angle} must be null with {where}.board_lean={self.board_lean}; each "
                "follows from the other"
            )
        if self.height[0] < 0:
            raise ConfigError(f"{where}.height={self.height} must be >= 0 m; the robot would start inside the ground")
        if not 0 <= self.edge_margin < math.inf:
            raise ConfigError(f"{where}.edge_margin={self.edge_margin} must be 0 or more and finite, in m")
