"""The Unitree A1: its link inertias, joint frames, joint ranges and collision shapes, in two variants.

The numbers come from the manufacturer's published robot description. Those of one leg and two signs give all legs:
`front` is +1 in front and -1 behind, `left` is +1 on the left and -1 on the right.
"""

from __future__ import annotations

import numpy as np

from skatemount.envs.robots.spec import (
    MAIN_AXES,
    Box,
    Capsule,
    Inertial,
    Leg,
    LegKinematics,
    Link,
    RobotSpec,
    merge,
    symmetric,
)

LEGS = ("FR", "FL", "RR", "RL")
LINKS = ("hip", "thigh", "calf")

# Ranges in rad. Front and rear legs are equal.
_RANGES = ((-0.802851, 0.802851), (-1.047198, 4.18879), (-2.696534, -0.916298))
_HIP_RADIUS = 0.04
_THIGH_RADIUS = 0.017
_CALF_RADIUS = 0.01


def leg_signs(leg: str) -> tuple[float, float]:
    """Return the signs of a leg: front is +1 for F and -1 for R, left is +1 for L and -1 for R."""
    return (1.0 if leg[0] == "F" else -1.0), (1.0 if leg[1] == "L" else -1.0)


def trunk_inertial(mass: float) -> Inertial:
    """Return the inertial of the trunk; the variants share center of mass and inertia."""
    inertia = symmetric(0.0158533, 0.0377999, 0.0456542, -3.66e-5, -6.11e-5, -2.75e-5)
    return Inertial(mass, np.array([0.0, 0.0041, -0.0005]), inertia)


def hip_inertial(leg: str) -> Inertial:
    """Return the inertial of a hip link, which contains the thigh's motor."""
    front, left = leg_signs(leg)
    return Inertial(
        0.696,
        np.array([-front * 0.003311, left * 0.000635, 3.1e-5]),
        symmetric(
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
        symmetric(0.005529065, 0.005139339, 0.001367788, left * 4.825e-6, 3.43869e-4, left * 2.2448e-5),
    )


def calf_inertial() -> Inertial:
    """Return the inertial of a calf and its foot, which are one body here; all legs share it."""
    calf = Inertial(
        0.166,
        np.array([0.006435, 0.0, -0.107388]),
        symmetric(0.002997972, 0.003014022, 3.2426e-5, 0.0, -1.41163e-4, 0.0),
    )
    foot = Inertial(0.06, np.array([0.0, 0.0, -0.2]), 9.6e-6 * np.eye(3))
    return merge(calf, foot)


def _leg(name: str, kin: LegKinematics) -> Leg:
    front, left = leg_signs(name)
    # The shank ends a foot radius above the foot's sphere. Only the sphere can then touch a floor in any pose in which
    # the shank is above the horizontal.
    ankle = kin.calf_length - kin.foot_radius - _CALF_RADIUS
    inertials = (hip_inertial(name), thigh_inertial(name), calf_inertial())
    shapes = (
        Capsule(_HIP_RADIUS, (0, left * 0.03, 0), (0, left * 0.08, 0)),
        Capsule(_THIGH_RADIUS, (0, 0, -0.02), (0, 0, 0.01 - kin.thigh_length)),
        Capsule(_CALF_RADIUS, (0, 0, -0.01), (0, 0, -ankle)),
    )
    links = tuple(
        Link(f"{name}_{link}", f"{name}_{link}_joint", axis, limits, inertial, shape)
        for link, axis, limits, inertial, shape in zip(LINKS, MAIN_AXES, _RANGES, inertials, shapes, strict=True)
    )
    return Leg(name, front, left, f"{name}_foot", links)


def _spec(trunk_mass: float, hip_x: float, thigh_y: float) -> RobotSpec:
    kin = LegKinematics(hip_x=hip_x, hip_y=0.047, thigh_y=thigh_y, thigh_length=0.2, calf_length=0.2, foot_radius=0.02)
    return RobotSpec(
        name="a1",
        trunk="trunk",
        trunk_inertial=trunk_inertial(trunk_mass),
        trunk_shape=Box((0.1335, 0.097, 0.057)),
        legs=tuple(_leg(name, kin) for name in LEGS),
        kinematics=kin,
        leg_radius=0.02,
        look="a1",
    )


A1 = _spec(trunk_mass=4.713, hip_x=0.183, thigh_y=0.08505)
"""The published robot, 12.453 kg."""

# A trunk of 6 kg, and the 1 g body of its inertial sensor.
A1_ISAAC = _spec(trunk_mass=6.001, hip_x=0.1805, thigh_y=0.0838)
"""The robot of the paper's code, 13.741 kg."""
