"""A quadruped as a composer entity, built from its `RobotSpec` and its settings."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from dm_control import composer, mjcf

from skatemount.envs.config.robot import RobotConfig
from skatemount.envs.entities import a1_visuals, go2_visuals, plain_visuals
from skatemount.envs.robots.layout import JointLayout
from skatemount.envs.robots.spec import Leg, LegKinematics, Link, RobotSpec
from skatemount.utils.errors import ConfigError

__all__ = [
    "KD_INDEX",
    "KP_INDEX",
    "LOOKS",
    "LegKinematics",
    "Quadruped",
    "RobotConfig",
    "scale_gains",
    "scale_torque_limit",
]

# Where `actuator_gainprm` of a DC-motor actuator holds the winding's resistance and the controller's gains.
RESISTANCE_INDEX = 0
KP_INDEX = 4
KD_INDEX = 6

LOOKS: dict[str, Callable[[mjcf.RootElement, RobotSpec], None]] = {
    "a1": a1_visuals.add_visuals,
    "go2": go2_visuals.add_visuals,
    "plain": plain_visuals.add_visuals,
}
"""Functions that add what is only drawn to a robot's model, by `RobotSpec.look`. A robot's own look is added with
``LOOKS[name] = function``."""


class Quadruped(composer.Entity):
    """A quadruped whose controls are joint position targets.

    The root frame is the trunk frame: origin at the trunk's center, x forward, z up. Joints, actuators and feet are in
    the order of the spec. Each actuator is a position controller in front of a DC motor. With target u, angle q and
    speed v its torque is, for |v| <= V,

        clip(kp (u - q) - kd v,  max(-T, T (-1 - v/V)),  min(T, T (1 - v/V)))

    where T is `torque_limit` and V is `speed_limit`. The line continues beyond V, where the motor brakes because its
    supply voltage is below the voltage that it generates. There is no actuator state.

    The compiled model keeps the gains of actuator i in `actuator_gainprm[i, KP_INDEX]` and `actuator_gainprm[i,
    KD_INDEX]`, in the units of `RobotConfig`; `scale_gains` changes them. The torque limit is in the resistance
    `actuator_gainprm[i, RESISTANCE_INDEX]` and in `actuator_forcerange[i]`; `scale_torque_limit` changes it.
    """

    def _build(self, config: RobotConfig, name: str | None = None) -> None:
        self._config = config
        self._config.validate()
        self._spec = self._config.spec
        if self._spec.look not in LOOKS:
            raise ConfigError(f"robot {self._spec.name}: look={self._spec.look!r} must be one of {', '.join(LOOKS)}")
        self._layout = JointLayout.of(self._spec)
        self._mjcf_root = mjcf.RootElement(model=name or self._spec.name)
        self._mjcf_root.compiler.angle = "radian"
        self._add_defaults()

        self._joints: list[mjcf.Element] = []
        self._actuators: list[mjcf.Element] = []
        self._feet: list[mjcf.Element] = []
        self._foot_geoms: list[mjcf.Element] = []
        self._body_geoms: dict[str, list[mjcf.Element]] = {}
        self._build_trunk()
        for leg in self._spec.legs:
            self._build_leg(leg)
        LOOKS[self._spec.look](self._mjcf_root, self._spec)

    def _add_defaults(self) -> None:
        config, default = self._config, self._mjcf_root.default
        default.joint.set_attributes(
            type="hinge",
            limited=True,
            frictionloss=config.joint_friction,
            damping=config.joint_damping,
            armature=config.armature,
        )
        # Contact bits: the robot collides with floors and boards, whose conaffinity is bit 1, but not with itself.
        collision = default.add("default", dclass="collision")
        collision.geom.set_attributes(contype=1, conaffinity=0, condim=3, group=3, rgba=(0.9, 0.3, 0.2, 0.3))
        foot = collision.add("default", dclass="foot")
        foot.geom.set_attributes(friction=(config.foot_friction, 0.005, 0.0001))
        visual = default.add("default", dclass="visual")
        visual.geom.set_attributes(contype=0, conaffinity=0, group=2, mass=0)
        default.site.set_attributes(type="sphere", size=(0.005,), group=4)
        # No activation: every time constant (dynprm) is zero.
        default.general.set_attributes(
            dyntype="dcmotor",
            gaintype="dcmotor",
            biastype="dcmotor",
            input="pos",
            actearly=True,
            dynprm=(0.0,),
            forcelimited=True,
            **self._motor(),
        )

    def _motor(self, reduction: float = 1.0) -> dict[str, Any]:
        """Return the actuator attributes of a motor behind a transmission."""
        config = self._config
        # One volt per rad/s makes the motor constant 1 N m/A, so the resistance that gives the stall torque T at V
        # volts is V/T.
        torque, volts = config.torque_limit * reduction, config.speed_limit / reduction
        return {
            "gainprm": (volts / torque, 1.0, 0, 0, config.kp, 0, config.kd, volts),
            "forcerange": (-torque, torque),
        }

    def _build_trunk(self) -> None:
        spec = self._spec
        self._trunk = self._mjcf_root.worldbody.add("body", name=spec.trunk)
        self._trunk.add("inertial", **spec.trunk_inertial.mjcf())
        self._imu = self._trunk.add("site", name="imu")
        self._add_collision(self._trunk, **spec.trunk_shape.mjcf())

    def _build_leg(self, leg: Leg) -> None:
        kin = self._spec.kinematics
        foot_center = (0, 0, -kin.calf_length)
        positions = [
            (leg.front * kin.hip_x, leg.left * kin.hip_y, 0),
            (0, leg.left * kin.thigh_y, 0),
            (0, 0, -kin.thigh_length),
            foot_center,
        ]
        body = self._trunk
        for i, link in enumerate(leg.links):
            # Joints after the fourth lie in the origin of their parent, which is the center of the foot.
            body = self._add_link(body, link, positions[i] if i < len(positions) else (0, 0, 0))
        foot = {"name": leg.foot, "pos": foot_center if len(leg.links) < len(positions) else (0, 0, 0)}
        self._foot_geoms.append(body.add("geom", dclass="foot", type="sphere", size=(kin.foot_radius,), **foot))
        self._feet.append(body.add("site", **foot))

    def _add_link(self, parent: mjcf.Element, link: Link, pos: tuple[float, float, float]) -> mjcf.Element:
        body = parent.add("body", name=link.name, pos=pos)
        body.add("inertial", **link.inertial.mjcf())
        joint = body.add("joint", name=link.joint, axis=link.axis, range=link.range)
        actuator = self._mjcf_root.actuator.add("general", name=link.name, joint=joint)
        if link.reduction != 1:
            joint.armature = self._config.armature * link.reduction**2
            actuator.set_attributes(**self._motor(link.reduction))
        self._joints.append(joint)
        self._actuators.append(actuator)
        if link.shape is not None:
            self._add_collision(body, **link.shape.mjcf())
        return body

    def _add_collision(self, body: mjcf.Element, **shape: Any) -> None:
        geom = body.add("geom", name=f"{body.name}_collision", dclass="collision", **shape)
        self._body_geoms.setdefault(body.name, []).append(geom)

    @property
    def mjcf_model(self) -> mjcf.RootElement:
        """The robot's MJCF model; its world body is the trunk frame."""
        return self._mjcf_root

    @property
    def config(self) -> RobotConfig:
        """The settings of the robot."""
        return self._config

    @property
    def spec(self) -> RobotSpec:
        """Numbers and names of the robot."""
        return self._spec

    @property
    def layout(self) -> JointLayout:
        """Order of the joints, feet and bodies."""
        return self._layout

    @property
    def trunk(self) -> mjcf.Element:
        """The trunk's body."""
        return self._trunk

    @property
    def joints(self) -> tuple[mjcf.Element, ...]:
        """The joints."""
        return tuple(self._joints)

    @property
    def actuators(self) -> tuple[mjcf.Element, ...]:
        """The actuators; their controls are joint position targets, rad."""
        return tuple(self._actuators)

    @property
    def feet(self) -> tuple[mjcf.Element, ...]:
        """Sites at the centers of the feet."""
        return tuple(self._feet)

    @property
    def foot_geoms(self) -> tuple[mjcf.Element, ...]:
        """The collision spheres of the feet."""
        return tuple(self._foot_geoms)

    @property
    def body_geoms(self) -> dict[str, list[mjcf.Element]]:
        """Collision geoms other than the feet by name of the body, the trunk first."""
        return {body: list(geoms) for body, geoms in self._body_geoms.items()}

    @property
    def imu(self) -> mjcf.Element:
        """Site at the trunk's origin, with its axes."""
        return self._imu

    @property
    def default_pose(self) -> np.ndarray:
        """Joint angles of a zero action, rad, shape (J,)."""
        config, pose = self._config, []
        for leg in self._spec.legs:
            pose += [-leg.left * config.hip_inward, config.thigh, config.calf]
            pose += [link.default for link in leg.links[3:]]
        return np.array(pose)

    @property
    def action_scale(self) -> np.ndarray:
        """Joint target offset per unit of action, rad, shape (J,)."""
        config, scale = self._config, []
        for leg in self._spec.legs:
            scale += [config.action_scale_hip, config.action_scale_thigh, config.action_scale_calf]
            scale += [link.action_scale for link in leg.links[3:]]
        return np.array(scale)

    @property
    def joint_range(self) -> np.ndarray:
        """Lower and upper joint limits, rad, shape (J, 2)."""
        return np.array([link.range for link in self._spec.links])

    @property
    def kinematics(self) -> LegKinematics:
        """Dimensions of the legs."""
        return self._spec.kinematics


def scale_gains(gainprm: Any, kp_scale: Any, kd_scale: Any) -> Any:
    """Scale the position and velocity gains of the robot's actuators, in a NumPy array or a torch tensor.

    Args:
        gainprm: `actuator_gainprm` of the robot's actuators, shape (..., J, 10).
        kp_scale: Factor of the position gain, broadcastable to (..., J).
        kd_scale: Factor of the velocity gain, broadcastable to (..., J).

    Returns:
        A new array of the shape of `gainprm`. Torque limit and torque-speed line are unchanged.
    """
    scaled = _copy(gainprm)
    scaled[..., KP_INDEX] *= kp_scale
    scaled[..., KD_INDEX] *= kd_scale
    return scaled


def scale_torque_limit(gainprm: Any, forcerange: Any, scale: Any) -> tuple[Any, Any]:
    """Scale the torque limit T of the robot's actuators, in NumPy arrays or torch tensors.

    The whole torque-speed line is scaled: the torque on the line by the resistance, the bound T by the force range.

    Args:
        gainprm: `actuator_gainprm` of the robot's actuators, shape (..., J, 10).
        forcerange: `actuator_forcerange` of the robot's actuators, shape (..., J, 2).
        scale: Factor, broadcastable to (..., J).

    Returns:
        New arrays of the shapes of `gainprm` and `forcerange`. The gains and the speed limit are unchanged.
    """
    weaker, narrower = _copy(gainprm), _copy(forcerange)
    weaker[..., RESISTANCE_INDEX] /= scale
    narrower *= scale[..., None]
    return weaker, narrower


def _copy(values: Any) -> Any:
    return values.clone() if hasattr(values, "clone") else np.array(values)
