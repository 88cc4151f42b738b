"""Settings of randomized physics and pushes."""

from __future__ import annotations

from dataclasses import dataclass

from skatemount.utils.errors import ConfigError, check_range


@dataclass
class RandomizationConfig:
    """Ranges ``[low, high]`` from which the physics of each world is drawn, uniformly unless stated otherwise.

    Gains are drawn at each reset of a world, the other values once for each world.

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
        push_interval: Time between two pushes, s; no pushes if null.
        push_velocity: Velocity that a push adds to each horizontal axis of the trunk, m/s.
    """

    friction: list[float]
    trunk_mass: list[float]
    trunk_com: list[float]
    inertia: list[float]
    board_mass: list[float]
    truck_stiffness: list[float]
    kp: list[float]
    kd: list[float]
    push_interval: list[float] | None
    push_velocity: list[float]

    def validate(self, where: str = "randomization") -> None:
        """Raise `ConfigError` if a range cannot be drawn from; ``where`` names the group in the message."""
        additive = ("trunk_mass", "trunk_com", "push_velocity")
        for name, value in vars(self).items():
            if value is None:
                continue
            check_range(f"{where}.{name}", value)
            if name not in additive and value[0] <= 0:
                raise ConfigError(f"{where}.{name}={value} must be above 0")
