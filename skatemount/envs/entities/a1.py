"""The Unitree A1 as a composer entity, built in code."""

from __future__ import annotations

from typing import Any

import numpy as np
from dm_control import composer, mjcf

from skatemount.envs.config.robot import A1Config
from skatemount.envs.entities import a1_links as links
from skatemount.envs.entities.a1_links import LegKinematics
from skatemount.envs.entities.a1_visuals import add_leg_visuals, add_materials, add_trunk_visuals

__all__ = ["A1", "A1Config", "KD_INDEX", "KP_INDEX", "LegKinematics", "scale_gains"]

# Where `actuator_gainprm` of a DC-motor actuator holds the controller's gains.
KP_INDEX = 4
KD_INDEX = 6

_TRUNK_HALF_SIZE = (0.1335, 0.097, 0.057)
_HIP_RADIUS = 0.04
_THIGH_RADIUS = 0.017
_CALF_RADIUS = 0.01


class A1(composer.Entity):
    """A Unitree A1 whose controls are joint position targets.

    The root frame is the trunk frame: origin at the trunk's center, x forward, z up. Joints, actuators and feet are in
    the order FR, FL, RR, RL (x hip, thigh, calf). Each actuator is a position controller in front of a DC motor. With
    target u, angle q and speed v its torque is, for |v| <= V,

        clip(kp (u - q) - kd v,  max(-T, T (-1 - v/V)),  min(T, T (1 - v/V)))

    where T is `torque_limit` and V is `speed_limit`. The line continues beyond V, where the motor brakes because its
    supply voltage is below the voltage that it generates. There is no actuator state.

    The compiled model keeps the gains of actuator i in `actuator_gainprm[i, KP_INDEX]` and `actuator_gainprm[i,
    KD_INDEX]`, in the units of `A1Config`; `scale_gains` changes them.
    """

    def _build(self, config: A1Config, name: str = "a1") -> None:
        self._config = config
        self._config.validate()
        self._kinematics = links.VARIANTS[self._config.variant].kinematics
        self._mjcf_root = mjcf.RootElement(model=name)
        self._mjcf_root.compiler.angle = "radian"
        self._add_defaults()
        add_materials(self._mjcf_root)

        self._joints: list[mjcf.Element] = []
        self._actuators: list[mjcf.Element] = []
        self._feet: list[mjcf.Element] = []
        self._foot_geoms: list[mjcf.Element] = []
        self._body_geoms: dict[str, list[mjcf.Element]] = {}
        self._build_trunk()
        for leg in links.LEGS:
            self._build_leg(leg)

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
        # One volt per rad/s makes the motor constant 1 N m/A, so the resistance that gives the stall torque T at V
        # volts is V/T. No activation: every time constant (dynprm) is zero.
        volts = config.speed_limit
        default.general.set_attributes(
            dyntype="dcmotor",
            gaintype="dcmotor",
            biastype="dcmotor",
            input="pos",
            actearly=True,
            dynprm=(0.0,),
            gainprm=(volts / config.torque_limit, 1.0, 0, 0, config.kp, 0, config.kd, volts),
            forcelimited=True,
            forcerange=(-config.torque_limit, config.torque_limit),
        )

    def _build_trunk(self) -> None:
        self._trunk = self._mjcf_root.worldbody.add("body", name="trunk")
        self._trunk.add("inertial", **links.trunk_inertial(self._config.variant).mjcf())
        self._imu = self._trunk.add("site", name="imu")
        self._add_collision(self._trunk, type="box", size=_TRUNK_HALF_SIZE)
        add_trunk_visuals(self._trunk, self._kinematics)

    def _build_leg(self, leg: str) -> None:
        front, left = links.leg_signs(leg)
        kin = self._kinematics
        shoulder = (front * kin.hip_x, left * kin.hip_y, 0)
        hip = self._add_link(self._trunk, leg, "hip", shoulder, links.hip_inertial(leg))
        inner = (0, left * kin.thigh_y, 0)
        thigh = self._add_link(hip, leg, "thigh", inner, links.thigh_inertial(leg))
        knee = (0, 0, -kin.thigh_length)
        calf = self._add_link(thigh, leg, "calf", knee, links.calf_inertial())
        self._add_capsule(hip, _HIP_RADIUS, (0, left * 0.03, 0), (0, left * 0.08, 0))
        self._add_capsule(thigh, _THIGH_RADIUS, (0, 0, -0.02), (0, 0, 0.01 - kin.thigh_length))
        # The shank ends a foot radius above the foot's sphere. Only the sphere can then touch a floor in any pose in
        # which the shank is above the horizontal.
        ankle = kin.calf_length - kin.foot_radius - _CALF_RADIUS
        self._add_capsule(calf, _CALF_RADIUS, (0, 0, -0.01), (0, 0, -ankle))

        foot = {"name": f"{leg}_foot", "pos": (0, 0, -kin.calf_length)}
        self._foot_geoms.append(calf.add("geom", dclass="foot", type="sphere", size=(kin.foot_radius,), **foot))
        self._feet.append(calf.add("site", **foot))
        add_leg_visuals(hip, thigh, calf, leg, kin)

    def _add_link(
        self,
        parent: mjcf.Element,
        leg: str,
        link: str,
        pos: tuple[float, float, float],
        inertial: links.Inertial,
    ) -> mjcf.Element:
        body = parent.add("body", name=f"{leg}_{link}", pos=pos)
        body.add("inertial", **inertial.mjcf())
        joint = body.add(
            "joint",
            name=f"{leg}_{link}_joint",
            axis=links.JOINT_AXES[link],
            range=links.JOINT_RANGES[link],
        )
        self._joints.append(joint)
        self._actuators.append(self._mjcf_root.actuator.add("general", name=f"{leg}_{link}", joint=joint))
        return body

    def _add_capsule(
        self,
        body: mjcf.Element,
        radius: float,
        start: tuple[float, float, float],
        end: tuple[float, float, float],
    ) -> None:
        self._add_collision(body, type="capsule", size=(radius,), fromto=(*start, *end))

    def _add_collision(self, body: mjcf.Element, **shape: Any) -> None:
        geom = body.add("geom", name=f"{body.name}_collision", dclass="collision", **shape)
        self._body_geoms.setdefault(body.name, []).append(geom)

    @property
    def mjcf_model(self) -> mjcf.RootElement:
        """The robot's MJCF model; its world body is the trunk frame."""
        return self._mjcf_root

    @property
    def config(self) -> A1Config:
        """The settings of the robot."""
        return self._config

    @property
    def trunk(self) -> mjcf.Element:
        """The trunk's body."""
        return self._trunk

    @property
    def joints(self) -> tuple[mjcf.Element, ...]:
        """The 12 joints."""
        return tuple(self._joints)

    @property
    def actuators(self) -> tuple[mjcf.Element, ...]:
        """The 12 actuators; their controls are joint position targets, rad."""
        return tuple(self._actuators)

    @property
    def feet(self) -> tuple[mjcf.Element, ...]:
        """Sites at the centers of the four feet."""
        return tuple(self._feet)

    @property
    def foot_geoms(self) -> tuple[mjcf.Element, ...]:
        """The four collision spheres of the feet."""
        return tuple(self._foot_geoms)

    @property
    def body_geoms(self) -> dict[str, list[mjcf.Element]]:
        """Collision geoms other than the feet by name of the body: trunk, FR_hip, FR_thigh, FR_calf, ..."""
        return {body: list(geoms) for body, geoms in self._body_geoms.items()}

    @property
    def imu(self) -> mjcf.Element:
        """Site at the trunk's origin, with its axes."""
        return self._imu

    @property
    def default_pose(self) -> np.ndarray:
        """Joint angles of a zero action, rad, shape (12,)."""
        config = self._config
        left = [links.leg_signs(leg)[1] for leg in links.LEGS]
        return np.array([angle for s in left for angle in (-s * config.hip_inward, config.thigh, config.calf)])

    @property
    def action_scale(self) -> np.ndarray:
        """Joint target offset per unit of action, rad, shape (12,)."""
        config = self._config
        scale = (config.action_scale_hip, config.action_scale_thigh, config.action_scale_calf)
        return np.tile(scale, len(links.LEGS))

    @property
    def joint_range(self) -> np.ndarray:
        """Lower and upper joint limits, rad, shape (12, 2)."""
        return np.array([links.JOINT_RANGES[link] for _ in links.LEGS for link in links.LINKS])

    @property
    def kinematics(self) -> LegKinematics:
        """Dimensions of the legs."""
        return self._kinematics


def scale_gains(gainprm: Any, kp_scale: Any, kd_scale: Any) -> Any:
    """Scale the position and velocity gains of the robot's actuators, in a NumPy array or a torch tensor.

    Args:
        gainprm: `actuator_gainprm` of the robot's actuators, shape (..., 12, 10).
        kp_scale: Factor of the position gain, broadcastable to (..., 12).
        kd_scale: Factor of the velocity gain, broadcastable to (..., 12).

    Returns:
        A new array of the shape of `gainprm`. Torque limit and torque-speed line are unchanged.
    """
    scaled = gainprm.clone() if hasattr(gainprm, "clone") else np.array(gainprm)
    scaled[..., KP_INDEX] *= kp_scale
    scaled[..., KD_INDEX] *= kd_scale
    return scaled
