"""The numbers of the Unitree A1: link inertias, joint frames and joint ranges, for each leg and variant.

They come from the manufacturer's published robot description. The numbers of one leg and two signs give all legs:
`front` is +1 in front and -1 behind, `left` is +1 on the left and -1 on the right.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

LEGS = ("FR", "FL", "RR", "RL")
LINKS = ("hip", "thigh", "calf")

# Ranges in rad. Front and rear legs are equal.
JOINT_RANGES = {
    "hip": (-0.802851, 0.802851),
    "thigh": (-1.047198, 4.18879),
    "calf": (-2.696534, -0.916298),
}
JOINT_AXES = {"hip": (1.0, 0.0, 0.0), "thigh": (0.0, 1.0, 0.0), "calf": (0.0, 1.0, 0.0)}


@dataclass(frozen=True)
class LegKinematics:
    """Dimensions of a leg, m; `leg_signs` gives the signs of x and y.

    With f and s the signs of a leg (front and left), the center of its foot in the trunk frame is

        [f hip_x, s hip_y, 0]
        + Rx(hip) ([0, s thigh_y, 0] + Ry(thigh) ([0, 0, -thigh_length] + Ry(calf) [0, 0, -calf_length]))
    """

    hip_x: float
    hip_y: float
    thigh_y: float
    thigh_length: float = 0.2
    calf_length: float = 0.2
    foot_radius: float = 0.02


@dataclass(frozen=True)
class Inertial:
    """A link's mass (kg), center of mass (m) and inertia about it (kg m^2), in the link's frame."""

    mass: float
    com: np.ndarray
    inertia: np.ndarray

    def mjcf(self) -> dict[str, object]:
        """Return the attributes of an MJCF `inertial` element."""
        i = self.inertia
        full = (i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2])
        return {"mass": self.mass, "pos": self.com, "fullinertia": full}


@dataclass(frozen=True)
class Variant:
    """The numbers in which the variants differ: trunk mass (kg) and dimensions of the legs."""

    trunk_mass: float
    kinematics: LegKinematics


VARIANTS = {
    "unitree": Variant(4.713, LegKinematics(hip_x=0.183, hip_y=0.047, thigh_y=0.08505)),
    # A trunk of 6 kg, and the 1 g body of its inertial sensor.
    "isaac": Variant(6.001, LegKinematics(hip_x=0.1805, hip_y=0.047, thigh_y=0.0838)),
}


def leg_signs(leg: str) -> tuple[float, float]:
    """Return the signs of a leg: front is +1 for F and -1 for R, left is +1 for L and -1 for R."""
    return (1.0 if leg[0] == "F" else -1.0), (1.0 if leg[1] == "L" else -1.0)


def trunk_inertial(variant: str) -> Inertial:
    """Return the inertial of the trunk; the variants share center of mass and inertia."""
    inertia = _symmetric(0.0158533, 0.0377999, 0.0456542, -3.66e-5, -6.11e-5, -2.75e-5)
    return Inertial(VARIANTS[variant].trunk_mass, np.array([0.0, 0.0041, -0.0005]), inertia)


def hip_inertial(leg: str) -> Inertial:
    """Return the inertial of a hip link, which contains the thigh's motor."""
    front, left = leg_signs(leg)
    return Inertial(
        0.696,
        np.array([-front * 0.003311, left * 0.000635, 3.1e-5]),
        _symmetric(
            0.000469246,
            0.00080749,
            0.000552929,
            -front * left * 9.409e-6,
            -front * 3.42e-7,
            -left * 4.66e-7,
        ),
    )


def thigh_inertial(leg: str) -> Inertial:
    """Return the inertial of a thigh link, which has the calf's motor at its top, on the inner side."""
    _, left = leg_signs(leg)
    return Inertial(
        1.013,
        np.array([-0.003237, -left * 0.022327, -0.027326]),
        _symmetric(0.005529065, 0.005139339, 0.001367788, left * 4.825e-6, 3.43869e-4, left * 2.2448e-5),
    )


def calf_inertial() -> Inertial:
    """Return the inertial of a calf and its foot, which are one body here; all legs share it."""
    calf = Inertial(
        0.166,
        np.array([0.006435, 0.0, -0.107388]),
        _symmetric(0.002997972, 0.003014022, 3.2426e-5, 0.0, -1.41163e-4, 0.0),
    )
    foot = Inertial(0.06, np.array([0.0, 0.0, -0.2]), 9.6e-6 * np.eye(3))
    return merge(calf, foot)


def merge(first: Inertial, second: Inertial) -> Inertial:
    """Combine two rigidly joined links, given in one frame, by the parallel-axis theorem."""
    mass = first.mass + second.mass
    com = (first.mass * first.com + second.mass * second.com) / mass
    inertia = np.zeros((3, 3))
    for part in (first, second):
        d = part.com - com
        inertia += part.inertia + part.mass * (d @ d * np.eye(3) - np.outer(d, d))
    return Inertial(mass, com, inertia)


def _symmetric(xx: float, yy: float, zz: float, xy: float, xz: float, yz: float) -> np.ndarray:
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
