"""Settings of the robot."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from skatemount.envs.robots import ROBOTS, RobotSpec
from skatemount.utils.errors import ConfigError


@dataclass
class RobotConfig:
    """Settings of the robot.

    Attributes:
        variant: The robot, a key of `skatemount.envs.robots.ROBOTS`: ``unitree`` (the published A1, 12.453 kg),
            ``isaac`` (the A1 of the paper's code, 13.741 kg), ``go2`` (the Unitree Go2, 15.019 kg), or one of a plugin.
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
    kp: float
    kd: float
    torque_limit: float
    speed_limit: float
    hip_inward: float
    thigh: float
    calf: float
    action_scale_hip: float
    action_scale_thigh: float
    action_scale_calf: float
    action_clip: float
    joint_friction: float
    joint_damping: float
    armature: float
    foot_friction: float

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
            raise ConfigError(f"{where}.variant={self.variant} must be one of {known}")
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name != "variant" and not np.isfinite(value):
                raise ConfigError(f"{where}.{field.name}={value} must be a finite number")
        for name in ("kp", "torque_limit", "speed_limit", "action_clip"):
            if getattr(self, name) <= 0:
                raise ConfigError(f"{where}.{name}={getattr(self, name)} must be above 0")
        scales = ("action_scale_hip", "action_scale_thigh", "action_scale_calf")
        passive = ("kd", "joint_friction", "joint_damping", "armature", "foot_friction")
        for name in scales + passive:
            if getattr(self, name) < 0:
                raise ConfigError(f"{where}.{name}={getattr(self, name)} must be >= 0")
        for i, name in enumerate(("hip_inward", "thigh", "calf")):
            low, high = self.spec.stance_range(i)
            if not low <= getattr(self, name) <= high:
                raise ConfigError(f"{where}.{name}={getattr(self, name)} must be from {low} to {high} rad")
