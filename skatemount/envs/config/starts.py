"""Settings of start states."""

from __future__ import annotations

from dataclasses import dataclass, field

from skatemount.utils.bounds import check_bounds, interval, number
from skatemount.utils.errors import ConfigError

MAX_TILT = 0.5
"""Largest roll and pitch, rad."""
_TILT = interval(
    -MAX_TILT, MAX_TILT, "rad", why="with a larger tilt, more than the robot's feet would touch the ground"
)


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
        board_speed: Speed at which a free board rolls along its x axis, m/s. A fixed board is at rest.
        either_way: True if the direction of ``board_speed`` is drawn. False if boards roll along their x axis, which is
            forward for a robot of yaw 0.
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

    x: list[float] = field(metadata=interval(-100, 100, "m"))
    y: list[float] = field(metadata=interval(-100, 100, "m"))
    both_sides: bool
    distance: list[float] | None = field(metadata=interval(0, 100, "m"))
    yaw: list[float] = field(metadata=interval(-10, 10, "rad"))
    roll: list[float] = field(metadata=_TILT)
    pitch: list[float] = field(metadata=_TILT)
    height: list[float] = field(metadata=interval(0, 5, "m", why="below 0 the robot would start inside the ground"))
    lin_vel: list[float] = field(metadata=interval(-20, 20, "m/s"))
    ang_vel: list[float] = field(metadata=interval(-50, 50, "rad/s"))
    joint_pos: list[float] = field(metadata=interval(-2, 2, "rad"))
    joint_vel: list[float] = field(metadata=interval(-100, 100, "rad/s"))
    step_height: list[float] | None = field(metadata=interval(-1, 1, "m"))
    board_fixed: float = field(metadata=number(0, 1))
    board_speed: list[float] = field(metadata=interval(0, 20, "m/s", why="the direction is drawn separately"))
    either_way: bool
    board_lean: list[float] = field(metadata=interval(-0.5, 0.5, "rad"))
    truck_angle: list[float] | None = field(metadata=interval(-0.5, 0.5, "rad"))
    move_with_board: bool
    drive: bool
    edge_margin: float = field(metadata=number(0, 1, "m"))
    force: list[float] = field(metadata=interval(-10_000, 10_000, "N"))
    torque: list[float] = field(metadata=interval(-1000, 1000, "N m"))

    def validate(self, where: str = "start") -> None:
        """Raise `ConfigError` if a range cannot be drawn from; ``where`` names the group in the message."""
        check_bounds(self, where)
        if self.board_fixed == 1 and self.board_speed[1] > 0:
            raise ConfigError(
                f"{where}.board_speed={self.board_speed} needs free boards: set {where}.board_fixed below 1, or "
                f"{where}.board_speed=[0,0]"
            )
        if self.truck_angle is not None and self.board_lean != [0.0, 0.0]:
            raise ConfigError(
                f"{where}.truck_angle={self.truck_angle} must be null with {where}.board_lean={self.board_lean}; each "
                "follows from the other"
            )
