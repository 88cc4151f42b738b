"""`JointLayout`: names, order and mirror image of a robot's joints, feet and bodies."""

from __future__ import annotations

from dataclasses import dataclass

from skatemount.envs.robots.spec import Leg, Link, RobotSpec


@dataclass(frozen=True)
class JointLayout:
    """The order of a robot's joints, feet and bodies in states, observations, actions, logs and cards.

    Joints are leg by leg, from the trunk outward. Every leg has the same number of them.

    Attributes:
        joints: Names of the J joints, as a policy's card says them.
        legs: Short names of the F legs, for labels.
        feet: Names of the F feet.
        bodies: Names of the B bodies that can touch something in addition to the feet, the trunk first.
        mirror_legs: For each leg the index of its left-right mirror image.
        mirror_joints: For each joint the index of its mirror image.
        joint_signs: For each joint the sign, 1 or -1, of its mirror image's angle.
        mirror_bodies: For each body the index of its mirror image.
        diagonals: The pairs of diagonally opposite legs.
    """

    joints: tuple[str, ...]
    legs: tuple[str, ...]
    feet: tuple[str, ...]
    bodies: tuple[str, ...]
    mirror_legs: tuple[int, ...]
    mirror_joints: tuple[int, ...]
    joint_signs: tuple[float, ...]
    mirror_bodies: tuple[int, ...]
    diagonals: tuple[tuple[int, int], ...]

    @classmethod
    def of(cls, spec: RobotSpec) -> JointLayout:
        """Return the layout of a robot.

        Args:
            spec: Numbers and names of the robot.

        Raises:
            ValueError: Two legs are not mirror images of each other; the message names the first difference.
        """
        legs = spec.legs
        images = [_find(legs, leg.front, -leg.left) for leg in legs]
        per_leg = len(legs[0].links)
        signs = [
            _sign(spec.name, link, image)
            for leg, at in zip(legs, images)
            for link, image in zip(leg.links, legs[at].links)
        ]
        solid = [(i, j) for i, leg in enumerate(legs) for j, link in enumerate(leg.links) if link.shape is not None]
        for i, j in solid:
            if (images[i], j) not in solid:
                raise ValueError(f"robot {spec.name}: {legs[i].links[j].name} has a shape, its mirror image has none")
        opposite = [_find(legs, -leg.front, -leg.left) for leg in legs]
        return cls(
            joints=tuple(link.name for link in spec.links),
            legs=tuple(leg.name for leg in legs),
            feet=tuple(leg.foot for leg in legs),
            bodies=(spec.trunk, *(legs[i].links[j].name for i, j in solid)),
            mirror_legs=tuple(images),
            mirror_joints=tuple(at * per_leg + j for at in images for j in range(per_leg)),
            joint_signs=tuple(signs),
            mirror_bodies=(0, *(1 + solid.index((images[i], j)) for i, j in solid)),
            diagonals=tuple((i, at) for i, at in enumerate(opposite) if i < at),
        )

    @property
    def num_joints(self) -> int:
        """Number of joints, J, which is the number of actions."""
        return len(self.joints)

    @property
    def num_feet(self) -> int:
        """Number of feet, F."""
        return len(self.feet)

    @property
    def num_bodies(self) -> int:
        """Number of bodies that can touch something in addition to the feet, B."""
        return len(self.bodies)

    @property
    def by_leg(self) -> tuple[int, int]:
        """Numbers of legs and of joints of a leg: the shape of the joints leg by leg."""
        return len(self.legs), len(self.joints) // len(self.legs)


def _find(legs: tuple[Leg, ...], front: float, left: float) -> int:
    """Return the index of the leg with the given signs."""
    return [(leg.front, leg.left) for leg in legs].index((front, left))


def _sign(robot: str, link: Link, image: Link) -> float:
    """Return the sign of the image's angle: an axis is an axial vector, whose x and z a mirror negates."""
    x, y, z = link.axis
    if image.axis == (x, -y, z):
        return -1.0
    if image.axis == (-x, y, -z):
        return 1.0
    raise ValueError(f"robot {robot}: the axis of {image.name} must mirror that of {link.name}")
