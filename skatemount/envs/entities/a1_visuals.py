"""Looks of the A1: primitives without mass or contact.

The shell is light, so that the robot stands out against floor and deck; the real one is black.
"""

from __future__ import annotations

from dm_control import mjcf

from skatemount.envs.entities.primitive_visuals import Material, add_materials, ball, box, disc, ellipsoid, rod
from skatemount.envs.robots.spec import Leg, LegKinematics, RobotSpec

_MATERIALS: dict[str, Material] = {
    "shell": ((0.90, 0.91, 0.92, 1.0), 0.4, 0.5, 0.0),
    "panel": ((0.16, 0.18, 0.22, 1.0), 0.4, 0.45, 0.0),
    "silver": ((0.55, 0.57, 0.60, 1.0), 0.9, 0.85, 0.0),
    "glass": ((0.02, 0.02, 0.03, 1.0), 1.0, 1.0, 0.1),
    "lens": ((0.1, 0.25, 0.5, 1.0), 1.0, 1.0, 0.2),
    "white": ((0.93, 0.93, 0.92, 1.0), 0.3, 0.4, 0.0),
    "orange": ((0.98, 0.43, 0.06, 1.0), 0.4, 0.5, 0.0),
    "rubber": ((0.05, 0.05, 0.05, 1.0), 0.05, 0.1, 0.0),
}


def add_visuals(root: mjcf.RootElement, spec: RobotSpec) -> None:
    """Add the looks of the A1 to its model."""
    add_materials(root, _MATERIALS)
    add_trunk_visuals(root.find("body", spec.trunk), spec)
    for leg in spec.legs:
        hip, thigh, calf = (root.find("body", link.name) for link in leg.links)
        add_leg_visuals(hip, thigh, calf, leg, spec.kinematics)


def add_trunk_visuals(trunk: mjcf.Element, spec: RobotSpec) -> None:
    """Add body shell, rails, head with cameras, tail, and the four hip motors to the trunk."""
    for side in (-1.0, 1.0):
        disc(trunk, "shell", 0.054, (-0.135, side * 0.042, 0), (0.135, side * 0.042, 0))
        rod(trunk, "silver", 0.0045, (-0.1, side * 0.05, 0.056), (0.1, side * 0.05, 0.056))
        box(trunk, "panel", (0, side * 0.094, 0), (0.1, 0.004, 0.024))
        box(trunk, "orange", (0.02, side * 0.0985, 0.011), (0.062, 0.001, 0.0025))
        box(trunk, "white", (0.02, side * 0.0985, 0.003), (0.062, 0.001, 0.0025))
    box(trunk, "shell", (0, 0, 0), (0.135, 0.042, 0.054))
    box(trunk, "panel", (0, 0, 0.054), (0.11, 0.038, 0.004))
    box(trunk, "silver", (-0.055, 0, 0.0585), (0.03, 0.022, 0.001))
    box(trunk, "panel", (0, 0, -0.054), (0.11, 0.05, 0.004))

    # Head: a rounded bar with the depth camera behind glass.
    box(trunk, "shell", (0.19, 0, 0.008), (0.06, 0.044, 0.036))
    rod(trunk, "shell", 0.036, (0.24, -0.042, 0.012), (0.24, 0.042, 0.012))
    box(trunk, "silver", (0.262, 0, 0.012), (0.013, 0.05, 0.017))
    box(trunk, "glass", (0.27, 0, 0.012), (0.007, 0.046, 0.013))
    for y in (-0.03, 0.008, 0.03):
        disc(trunk, "lens", 0.0065, (0.27, y, 0.012), (0.2785, y, 0.012))
    box(trunk, "orange", (0.236, 0, 0.0475), (0.012, 0.03, 0.0015))
    box(trunk, "white", (0.205, 0, 0.0445), (0.012, 0.03, 0.0015))

    # Tail: the same bar, shorter, with a handle.
    box(trunk, "shell", (-0.18, 0, 0.004), (0.05, 0.044, 0.036))
    rod(trunk, "shell", 0.034, (-0.222, -0.04, 0.006), (-0.222, 0.04, 0.006))
    box(trunk, "orange", (-0.252, 0, 0.012), (0.006, 0.025, 0.004))

    kin = spec.kinematics
    for leg in spec.legs:
        front = leg.front
        x, y = front * kin.hip_x, leg.left * kin.hip_y
        disc(trunk, "panel", 0.045, (x - front * 0.075, y, 0), (x - front * 0.03, y, 0))
        disc(trunk, "silver", 0.041, (x - front * 0.03, y, 0), (x - front * 0.026, y, 0))


def add_leg_visuals(hip: mjcf.Element, thigh: mjcf.Element, calf: mjcf.Element, leg: Leg, kin: LegKinematics) -> None:
    """Add hip housing, thigh with the knee's motor, shank and rubber foot of one leg."""
    front, s = leg.front, leg.left
    # Hip: the yoke on the roll axis and the thigh's motor across it.
    disc(hip, "shell", 0.037, (-front * 0.026, 0, 0), (front * 0.038, 0, 0))
    disc(hip, "silver", 0.027, (front * 0.038, 0, 0), (front * 0.042, 0, 0))
    disc(hip, "shell", 0.044, (0, s * 0.012, 0), (0, s * 0.052, 0))
    disc(hip, "silver", 0.0455, (0, s * 0.052, 0), (0, s * 0.056, 0))

    # Thigh: the motor's drum, a tapered blade down to the knee.
    disc(thigh, "panel", 0.044, (0, -s * 0.028, 0), (0, s * 0.02, 0))
    disc(thigh, "orange", 0.0445, (0, s * 0.008, 0), (0, s * 0.011, 0))
    disc(thigh, "silver", 0.034, (0, s * 0.02, 0), (0, s * 0.0235, 0))
    disc(thigh, "shell", 0.026, (0, s * 0.0235, 0), (0, s * 0.025, 0))
    ellipsoid(thigh, "shell", (-0.004, 0, -0.072), (0.036, 0.0185, 0.088))
    rod(thigh, "shell", 0.0165, (-0.003, 0, -0.08), (0, 0, -kin.thigh_length))
    ellipsoid(thigh, "white", (-0.002, s * 0.0125, -0.105), (0.01, 0.006, 0.042))
    knee = -kin.thigh_length
    disc(thigh, "panel", 0.021, (0, -0.0165, knee), (0, 0.0165, knee))
    for side in (-1.0, 1.0):
        disc(thigh, "silver", 0.013, (0, side * 0.0165, knee), (0, side * 0.019, knee))

    # Calf: a slim bowed shank that ends in a rubber boot.
    ellipsoid(calf, "panel", (0.004, 0, -0.055), (0.0165, 0.0105, 0.066))
    rod(calf, "panel", 0.0095, (0.006, 0, -0.07), (0, 0, -0.18))
    disc(calf, "silver", 0.0118, (0.0012, 0, -0.155), (0.0009, 0, -0.162))
    rod(calf, "rubber", 0.0125, (0.0007, 0, -0.168), (0, 0, -kin.calf_length))
    ball(calf, "rubber", (0, 0, -kin.calf_length), kin.foot_radius)
