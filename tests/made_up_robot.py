"""A robot that does not exist: 16 joints, left legs first, names of its own, a knee behind a transmission."""

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
    symmetric,
)

KINEMATICS = LegKinematics(0.2, 0.06, 0.09, thigh_length=0.21, calf_length=0.22, foot_radius=0.025)
LEGS = {"lf": (1, 1), "rf": (1, -1), "lh": (-1, 1), "rh": (-1, -1)}
PARTS = ("abductor", "femur", "tibia", "ankle")
ANKLE, ANKLE_SCALE = 0.05, 0.1


def _leg(name: str, front: int, left: int) -> Leg:
    k = KINEMATICS
    axes = (*MAIN_AXES, (1.0, 0.0, 0.0))
    ranges = ((-0.9, 0.9), (-1.0, 3.5), (-2.7, -0.6), (-0.5, 0.5))
    masses = (0.6, 1.0, 0.25, 0.05)
    middles = ((0, left * 0.05, 0), (0, 0, -k.thigh_length / 2), (0, 0, -k.calf_length / 2), (0, 0, 0))
    shapes = (
        Capsule(0.03, (0, left * 0.04, 0), (0, left * 0.08, 0)),
        Capsule(0.018, (0, 0, -0.03), (0, 0, 0.01 - k.thigh_length)),
        Capsule(0.012, (0, 0, -0.02), (0, 0, 0.04 - k.calf_length)),
        None,
    )
    links = tuple(
        Link(
            name=f"{part}_{name}",
            joint=f"turn_{part}_{name}",
            axis=axes[i],
            range=ranges[i],
            inertial=Inertial(masses[i], np.array(middles[i], dtype=float), symmetric(*[masses[i] * 4e-3] * 3)),
            shape=shapes[i],
            reduction=1.5 if part == "tibia" else 1.0,
            default=ANKLE if part == "ankle" else 0.0,
            action_scale=ANKLE_SCALE if part == "ankle" else 0.0,
        )
        for i, part in enumerate(PARTS)
    )
    return Leg(name, front, left, f"sole_{name}", links)


SPEC = RobotSpec(
    name="beetle",
    trunk="shell",
    trunk_inertial=Inertial(5.0, np.zeros(3), symmetric(0.02, 0.04, 0.05)),
    trunk_shape=Box((0.15, 0.08, 0.05)),
    legs=tuple(_leg(name, *signs) for name, signs in LEGS.items()),
    kinematics=KINEMATICS,
    leg_radius=0.02,
)
