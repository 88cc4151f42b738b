"""Settings of the robot."""

from __future__ import annotations

from dataclasses import dataclass, field

from skatemount.envs.robots import ROBOTS, RobotSpec
from skatemount.utils.bounds import check_bounds, number
from skatemount.utils.errors import ConfigError


@dataclass
class RobotConfig:
    """Settings of the robot.

    Attributes:
        variant: The robot, a key of `skatemount.envs.robots.ROBOTS`: ``a1`` (the published A1, 12.453 kg),
            ``a1_isaac`` (the A1 of the paper's code, 13.741 kg), ``go2`` (the Unitree Go2, 15.019 kg), or one of a
            plugin.
        kp: Position gain of every joint, N m/rad.
        kd: Velocity gain of every joint, N m s/rad.
        torque_limit: Largest torque T of a motor, N m.
        speed_limit: Speed V at which a motor's torque falls to zero, rad/s.
        hip_inward: Default hip angle, rad; positive on the right and negative on the left, which narrows the stance.
        thigh: Default thigh angle, rad.
        calf: Default calf angle, rad.
        action_scale_hip: Joint target offset per unit of action at the hips, rad.
        action_scale_thigh: Joint target offset per unit of action at the thighs, rad.
        action_scale_calf: Joint target offset per unit of action at the calves, rad.
        action_clip: Largest absolute value of an action before it is scaled.
        joint_friction: Dry friction of every joint, N m.
        joint_damping: Viscous friction of every joint, N m s/rad.
        armature: Rotor inertia reflected to the joint, kg m^2.
        foot_friction: Sliding friction coefficient of the feet. MuJoCo uses the larger friction of two touching geoms.
    """

    variant: str
    kp: float = field(metadata=number(0, 10_000, "N m/rad", above=True))
    kd: float = field(metadata=number(0, 1000, "N m s/rad"))
    torque_limit: float = field(metadata=number(0, 10_000, "N m", above=True))
    speed_limit: float = field(metadata=number(0, 1000, "rad/s", above=True))
    hip_inward: float
    thigh: float
    calf: float
    action_scale_hip: float = field(metadata=number(0, 10, "rad"))
    action_scale_thigh: float = field(metadata=number(0, 10, "rad"))
    action_scale_calf: float = field(metadata=number(0, 10, "rad"))
    action_clip: float = field(metadata=number(0, 1000, above=True))
    joint_friction: float = field(metadata=number(0, 100, "N m"))
    joint_damping: float = field(metadata=number(0, 100, "N m s/rad"))
    armature: float = field(metadata=number(0, 10, "kg m2"))
    foot_friction: float = field(metadata=number(0, 10))

    @property
    def spec(self) -> RobotSpec:
        """Numbers and names of the robot."""
        return ROBOTS[self.variant]

    def validate(self, where: str = "robot") -> None:
        """Check every setting.

        Args:
            where: Name of the group, for messages.

        Raises:
            ConfigError: A setting cannot be used.
        """
        if self.variant not in ROBOTS:
            known = ", ".join(ROBOTS)
            raise ConfigError(
                f"{where}.variant={self.variant} must be one of {known}; one of your own needs plugins=[<module>]"
            )
        check_bounds(self, where)
        if not any((self.action_scale_hip, self.action_scale_thigh, self.action_scale_calf)):
            raise ConfigError(
                f"{where}.action_scale_hip={self.action_scale_hip}, action_scale_thigh and action_scale_calf must not "
                "all be 0: no action would move the robot"
            )
        for i, name in enumerate(("hip_inward", "thigh", "calf")):
            low, high = self.spec.stance_range(i)
            if not low <= getattr(self, name) <= high:
                raise ConfigError(f"{where}.{name}={getattr(self, name)} must be from {low} to {high} rad")
