"""Settings of randomized physics and pushes."""

from __future__ import annotations

from dataclasses import dataclass, field

from skatemount.utils.bounds import check_bounds, interval


@dataclass
class RandomizationConfig:
    """Ranges ``[low, high]`` from which the physics of each world is drawn, uniformly unless stated otherwise.

    Gains and torque limit are drawn at each reset of a world, the other values once for each world.

    Attributes:
        friction: Factor on the sliding friction of the robot, the deck and the robot's floor together, because MuJoCo
            uses the larger friction of two touching geoms.
        trunk_mass: Mass added to the trunk, kg.
        trunk_com: Offset added to each axis of the trunk's center of mass, m.
        inertia: Factor on the inertia of every robot body.
        board_mass: Factor on mass and inertia of the deck.
        truck_stiffness: Factor on the stiffness of the trucks' bushings.
        kp: Factor on the position gain of all joints, log-uniform.
        kd: Factor on the velocity gain of all joints, log-uniform.
        torque_limit: Factor on the torque limit of all motors, and so on their whole torque-speed line, log-uniform.
        push_interval: Time between two pushes, s; no pushes if null.
        push_velocity: Velocity that a push adds to each horizontal axis of the trunk, m/s.
    """

    friction: list[float] = field(metadata=interval(0, 10, above=True))
    trunk_mass: list[float] = field(metadata=interval(-50, 50, "kg"))
    trunk_com: list[float] = field(metadata=interval(-0.5, 0.5, "m"))
    inertia: list[float] = field(metadata=interval(0, 100, above=True))
    board_mass: list[float] = field(metadata=interval(0, 100, above=True))
    truck_stiffness: list[float] = field(metadata=interval(0, 100, above=True))
    kp: list[float] = field(metadata=interval(0, 100, above=True))
    kd: list[float] = field(metadata=interval(0, 100, above=True))
    torque_limit: list[float] = field(metadata=interval(0, 100, above=True))
    push_interval: list[float] | None = field(metadata=interval(0, 3600, "s", above=True))
    push_velocity: list[float] = field(metadata=interval(-20, 20, "m/s"))

    def validate(self, where: str = "randomization") -> None:
        """Raise `ConfigError` if a range cannot be drawn from; ``where`` names the group in the message."""
        check_bounds(self, where)
