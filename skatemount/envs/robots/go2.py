"""The Unitree Go2: its link inertias, joint frames, joint ranges, motors and collision shapes.

The numbers come from the manufacturer's URDF (``go2_description.urdf``) and from the model of MuJoCo Menagerie
(``unitree_go2/go2.xml``), both under the BSD-3-Clause license; ``NOTICE.md`` in this folder has the notice. The two
differ in the calves; docs/robots.md lists how, and says which one is used.

The numbers of one leg and two signs give all legs: `front` is +1 in front and -1 behind, `left` is +1 on the left and
-1 on the right.
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
SIGNS = {"FR": (1.0, -1.0), "FL": (1.0, 1.0), "RR": (-1.0, -1.0), "RL": (-1.0, 1.0)}
"""Front and left of each leg."""

TORQUE = 23.7
"""Largest torque of a motor at hip and thigh, N m."""
SPEED = 30.1
"""Largest speed of a motor at hip and thigh, rad/s."""
CALF_TORQUE = 45.43
"""Largest torque at a calf, N m: the same motor behind a linkage."""
CALF_REDUCTION = CALF_TORQUE / TORQUE
"""Ratio of the linkage that drives a calf, 1.917. It gives the published speed of 15.70 rad/s."""

KINEMATICS = LegKinematics(
    hip_x=0.1934, hip_y=0.0465, thigh_y=0.0955, thigh_length=0.213, calf_length=0.213, foot_radius=0.022
)


def trunk_inertial() -> Inertial:
    """Return the inertial of the trunk with the two bodies of 1 g at its head."""
    trunk = Inertial(
        6.921,
        np.array([0.021112, 0.0, -0.005366]),
        symmetric(0.02448, 0.098077, 0.107, 0.00012166, 0.0014849, -3.12e-5),
    )
    for place in ((0.285, 0.0, 0.01), (0.293, 0.0, -0.06)):
        trunk = merge(trunk, Inertial(0.001, np.array(place), 9.6e-6 * np.eye(3)))
    return trunk


def hip_inertial(front: float, left: float) -> Inertial:
    """Return the inertial of a hip link, which contains the thigh's motor."""
    return Inertial(
        0.678,
        np.array([-front * 0.0054, left * 0.00194, -0.000105]),
        symmetric(0.00048, 0.000884, 0.000596, -front * left * 3.01e-6, front * 1.11e-6, -left * 1.42e-6),
    )


def thigh_inertial(left: float) -> Inertial:
    """Return the inertial of a thigh link, which has the calf's motor at its top."""
    return Inertial(
        1.152,
        np.array([-0.00374, -left * 0.0223, -0.0327]),
        symmetric(0.00584, 0.0058, 0.00103, left * 8.72e-5, -0.000289, left * 0.000808),
    )


def calf_inertial(left: float) -> Inertial:
    """Return the inertial of a calf and its foot, which are one body here."""
    calf = Inertial(
        0.154,
        np.array([0.00548, -left * 0.000975, -0.115]),
        symmetric(0.00108, 0.0011, 3.29e-5, left * 3.4e-7, 1.72e-5, left * 8.28e-6),
    )
    foot = Inertial(0.04, np.array([0.0, 0.0, -KINEMATICS.calf_length]), 9.6e-6 * np.eye(3))
    return merge(calf, foot)


def _leg(name: str) -> Leg:
    front, left = SIGNS[name]
    # The rear thighs turn further back: their published range is that of the front ones, 60 degrees higher.
    thigh_range = (-1.5708, 3.4907) if front > 0 else (-0.5236, 4.5379)
    ranges = ((-1.0472, 1.0472), thigh_range, (-2.7227, -0.83776))
    inertials = (hip_inertial(front, left), thigh_inertial(left), calf_inertial(left))
    shapes = (
        Capsule(0.046, (0, left * 0.06, 0), (0, left * 0.1, 0)),
        Capsule(0.017, (0, 0, -0.02), (0, 0, 0.01 - KINEMATICS.thigh_length)),
        # The shank is bent forward; this goes along the two published cylinders.
        Capsule(0.013, (0.002, 0, -0.013), (0.02, 0, -0.168)),
    )
    links = tuple(
        Link(
            f"{name}_{link}",
            f"{name}_{link}_joint",
            MAIN_AXES[i],
            ranges[i],
            inertials[i],
            shapes[i],
            reduction=CALF_REDUCTION if link == "calf" else 1.0,
        )
        for i, link in enumerate(LINKS)
    )
    return Leg(name, front, left, f"{name}_foot", links)


GO2 = RobotSpec(
    name="go2",
    trunk="base",
    trunk_inertial=trunk_inertial(),
    # The published box, longer in front by the head.
    trunk_shape=Box((0.26155, 0.04675, 0.057), center=(0.07345, 0, 0)),
    legs=tuple(_leg(name) for name in LEGS),
    kinematics=KINEMATICS,
    leg_radius=0.033,
    look="go2",
)
"""The published robot, 15.019 kg."""
