"""Settings of randomization and pushes."""

from __future__ import annotations

from dataclasses import dataclass

from skatemount.utils.errors import ConfigError, check_range


@dataclass
class RandomizationConfig:
    """Ranges ``[low, high]`` that each world's physics is drawn from, uniformly unless said otherwise.

    What concerns masses and friction is drawn once a world, gains at each of its resets.

    Attributes:
        friction: Factor on the sliding friction of the robot, the deck and the robot's floor alike: of two geoms
            that touch, MuJoCo takes the larger friction.
        trunk_mass: Added to the trunk, kg.
        trunk_com: Added to each axis of the trunk's centre of mass, m.
        inertia: Factor on the inertia of every robot body.
        board_mass: Factor on mass and inertia of the deck.
        truck_stiffness: Factor on the stiffness of the trucks' bushings.
        kp: Factor on the joints' stiffness, log-uniform.
        kd: Factor on the joints' damping, log-uniform.
        push_interval: Seconds between two pushes; no pushes if null.
        push_velocity: Each horizontal axis of what a push adds to the trunk's velocity, m/s.
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
        """Raise `ConfigError` for ranges that cannot be drawn from."""
        additive = ("trunk_mass", "trunk_com", "push_velocity")
        for name, value in vars(self).items():
            if value is None:
                continue
            check_range(f"{where}.{name}", value)
            if name not in additive and value[0] <= 0:
                raise ConfigError(f"{where}.{name}={value} must be above 0")
