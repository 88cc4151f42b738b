"""`RobotSpec`: every number and name of a quadruped. It needs neither torch nor MuJoCo."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

Vector = tuple[float, float, float]

MAIN_AXES: tuple[Vector, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 1.0, 0.0))
"""Axes of hip, thigh and calf, which `LegKinematics` assumes."""


@dataclass(frozen=True)
class LegKinematics:
    """Dimensions of the legs, m.

    With f and s the signs of a leg (front and left), the center of its foot in the trunk frame is

        [f hip_x, s hip_y, 0]
        + Rx(hip) ([0, s thigh_y, 0] + Ry(thigh) ([0, 0, -thigh_length] + Ry(calf) [0, 0, -calf_length]))

    Attributes:
        hip_x: Distance of the hip's axis from the trunk's center, forward or backward.
        hip_y: The same distance to the side.
        thigh_y: Distance between hip and thigh to the side.
        thigh_length: Distance between thigh joint and knee.
        calf_length: Distance between the knee and the foot's center.
        foot_radius: Radius of the foot, a sphere.
    """

    hip_x: float
    hip_y: float
    thigh_y: float
    thigh_length: float
    calf_length: float
    foot_radius: float


@dataclass(frozen=True, eq=False)
class Inertial:
    """A link's mass (kg), center of mass (m) and inertia about it (kg m^2), in the link's frame."""

    mass: float
    com: np.ndarray
    inertia: np.ndarray

    def problem(self, body: str) -> str | None:
        """Return in one line why no rigid body can have these numbers; None if one can.

        Args:
            body: Name of the link, for the message.
        """
        if not (np.isfinite(self.mass) and self.mass > 0):
            return f"the mass of {body} must be above 0 kg, not {self.mass}"
        if np.shape(self.com) != (3,) or not np.isfinite(self.com).all():
            return f"the center of mass of {body} must be 3 finite numbers, not {self.com}"
        if np.shape(self.inertia) != (3, 3) or not np.allclose(self.inertia, np.transpose(self.inertia), atol=0):
            return f"the inertia of {body} must be a symmetric 3 x 3 matrix"
        small, middle, large = np.linalg.eigvalsh(self.inertia)
        if not small > 0:
            return f"the principal inertias of {body} must be above 0 kg m^2, the smallest is {small:.3g}"
        if small + middle < large:
            return (
                f"the largest principal inertia of {body} must not exceed the sum of the others, but "
                f"{large:.3g} > {small:.3g} + {middle:.3g} kg m^2"
            )
        return None

    def mjcf(self) -> dict[str, object]:
        """Return the attributes of an MJCF `inertial` element."""
        i = self.inertia
        full = (i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2])
        return {"mass": self.mass, "pos": self.com, "fullinertia": full}


def symmetric(xx: float, yy: float, zz: float, xy: float = 0.0, xz: float = 0.0, yz: float = 0.0) -> np.ndarray:
    """Return the symmetric ``[3, 3]`` matrix with the given entries."""
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def merge(first: Inertial, second: Inertial) -> Inertial:
    """Combine two rigidly joined links, given in one frame, by the parallel-axis theorem."""
    mass = first.mass + second.mass
    com = (first.mass * first.com + second.mass * second.com) / mass
    inertia = np.zeros((3, 3))
    for part in (first, second):
        d = part.com - com
        inertia += part.inertia + part.mass * (d @ d * np.eye(3) - np.outer(d, d))
    return Inertial(mass, com, inertia)


@dataclass(frozen=True)
class Box:
    """A collision box: half sizes and center in the link's frame, m."""

    half_size: Vector
    center: Vector = (0.0, 0.0, 0.0)

    def mjcf(self) -> dict[str, object]:
        """Return the attributes of an MJCF `geom` element."""
        return {"type": "box", "size": self.half_size, "pos": self.center}


@dataclass(frozen=True)
class Capsule:
    """A collision capsule: radius and the ends of its axis in the link's frame, m."""

    radius: float
    start: Vector
    end: Vector

    def mjcf(self) -> dict[str, object]:
        """Return the attributes of an MJCF `geom` element."""
        return {"type": "capsule", "size": (self.radius,), "fromto": (*self.start, *self.end)}


Shape = Box | Capsule
"""A collision shape."""


@dataclass(frozen=True)
class Link:
    """A link of a leg, and the motor and joint that move it.

    Attributes:
        name: Name of the body and of the actuator; policies name the joint by it.
        joint: Name of the joint.
        axis: Axis of the joint in the link's frame.
        range: Lower and upper limit of the joint, rad.
        inertial: Mass, center of mass and inertia.
        shape: Collision shape; none if only the foot touches anything.
        reduction: Ratio of a transmission between motor and joint. It multiplies the torque limit, divides the speed
            limit, and multiplies the armature by its square.
        default: Angle of a zero action, rad; used for the joints after the calf, the settings give the first three.
        action_scale: Joint target offset per unit of action, rad; used like ``default``.
    """

    name: str
    joint: str
    axis: Vector
    range: tuple[float, float]
    inertial: Inertial
    shape: Shape | None = None
    reduction: float = 1.0
    default: float = 0.0
    action_scale: float = 0.0


@dataclass(frozen=True)
class Leg:
    """A leg: hip, thigh and calf, then any further links.

    The kinematics place hip, thigh and calf. All further joints lie in the center of the foot, which they therefore do
    not move; the last link carries the foot.

    Attributes:
        name: Short name for labels, such as ``FR``.
        front: 1 for a front leg, -1 for a rear leg.
        left: 1 for a left leg, -1 for a right leg.
        foot: Name of the foot.
        links: The links from the trunk outward.
    """

    name: str
    front: float
    left: float
    foot: str
    links: tuple[Link, ...]


@dataclass(frozen=True)
class RobotSpec:
    """Every number and name of a quadruped. Gains, motor limits, friction and stance are settings of the robot.

    Attributes:
        name: Name of the robot's model, and prefix of its names in the scene.
        trunk: Name of the trunk's body.
        trunk_inertial: Mass, center of mass and inertia of the trunk.
        trunk_shape: Collision shape of the trunk.
        legs: The four legs, in the order of joints and feet.
        kinematics: Dimensions of the legs.
        leg_radius: Upper bound on the distance of the thighs' and calves' surfaces from the straight lines between
            thigh joint, knee and foot, m: start states keep this distance from board and floor.
        look: Name of the visible parts, a key of `skatemount.envs.entities.quadruped.LOOKS`.

    Raises:
        ValueError: Legs, links or names do not make a quadruped; the message names the first mistake.
    """

    name: str
    trunk: str
    trunk_inertial: Inertial
    trunk_shape: Shape
    legs: tuple[Leg, ...]
    kinematics: LegKinematics
    leg_radius: float
    look: str = "plain"

    def __post_init__(self) -> None:
        signs = sorted((leg.front, leg.left) for leg in self.legs)
        if signs != [(-1, -1), (-1, 1), (1, -1), (1, 1)]:
            raise ValueError(f"robot {self.name}: legs must be one each of front and rear, left and right, not {signs}")
        for leg in self.legs:
            if not leg.foot:
                raise ValueError(f"robot {self.name}: leg {leg.name} must name its foot")
            if len(leg.links) != len(self.legs[0].links) or len(leg.links) < len(MAIN_AXES):
                counts = [len(leg.links) for leg in self.legs]
                raise ValueError(f"robot {self.name}: legs must have equal numbers of links, 3 or more, not {counts}")
            for link, axis in zip(leg.links, MAIN_AXES):
                if link.axis != axis:
                    raise ValueError(f"robot {self.name}: the axis of {link.name} must be {axis}, not {link.axis}")
            for link in leg.links:
                if not link.range[0] < link.range[1]:
                    raise ValueError(f"robot {self.name}: the range of {link.name} must rise, not be {link.range}")
                if not link.reduction > 0:
                    raise ValueError(
                        f"robot {self.name}: the reduction of {link.name} must be above 0, not {link.reduction}"
                    )
        for body, inertial in ((self.trunk, self.trunk_inertial), *((link.name, link.inertial) for link in self.links)):
            if problem := inertial.problem(body):
                raise ValueError(f"robot {self.name}: {problem}")
        for name, value in (*vars(self.kinematics).items(), ("leg_radius", self.leg_radius)):
            # Legs may lie in one plane with the hip's axis.
            if not (0 < value < np.inf or value == 0 and name in ("hip_y", "thigh_y")):
                raise ValueError(f"robot {self.name}: {name} must be above 0 m, not {value}")
        for kind, names in (
            ("body", [self.trunk, *(link.name for link in self.links)]),
            ("joint", [link.joint for link in self.links]),
            ("foot", [leg.foot for leg in self.legs]),
        ):
            for name in names:
                if names.count(name) > 1:
                    raise ValueError(f"robot {self.name}: two {kind} names are {name}; every {kind} needs its own")

    @property
    def links(self) -> tuple[Link, ...]:
        """All links of the legs, in the order of the joints."""
        return tuple(link for leg in self.legs for link in leg.links)

    @property
    def mass(self) -> float:
        """Mass of the whole robot, kg."""
        return self.trunk_inertial.mass + sum(link.inertial.mass for link in self.links)

    def stance_range(self, index: int) -> tuple[float, float]:
        """Return the limits of a default angle that all legs share.

        Args:
            index: 0 for the hips, where a positive angle turns every leg inward, 1 for the thighs, 2 for the calves.

        Returns:
            Lower and upper limit, rad.
        """
        ranges = [leg.links[index].range for leg in self.legs]
        if index == 0:
            ranges = [(-high, -low) if leg.left > 0 else (low, high) for leg, (low, high) in zip(self.legs, ranges)]
        return max(low for low, _ in ranges), min(high for _, high in ranges)
