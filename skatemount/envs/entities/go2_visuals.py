"""Looks of the Go2: primitives without mass or contact.

Gray shell, dark motors, a rounded head with the scanner under its chin, and shanks that are bent forward.
"""

from __future__ import annotations

from dm_control import mjcf

from skatemount.envs.entities.primitive_visuals import Material, add_materials, ball, box, disc, ellipsoid, rod
from skatemount.envs.robots.spec import Leg, LegKinematics, RobotSpec

_MATERIALS: dict[str, Material] = {
    "shell": ((0.62, 0.66, 0.72, 1.0), 0.6, 0.6, 0.0),
    "panel": ((0.12, 0.13, 0.15, 1.0), 0.4, 0.45, 0.0),
    "metal": ((0.80, 0.82, 0.85, 1.0), 0.9, 0.85, 0.0),
    "glass": ((0.02, 0.02, 0.03, 1.0), 1.0, 1.0, 0.1),
    "light": ((0.35, 0.85, 1.0, 1.0), 0.8, 0.9, 0.0),
    "blue": ((0.10, 0.40, 0.85, 1.0), 0.4, 0.5, 0.0),
    "rubber": ((0.05, 0.05, 0.05, 1.0), 0.05, 0.1, 0.0),
}


def add_visuals(root: mjcf.RootElement, spec: RobotSpec) -> None:
    """Add the looks of the Go2 to its model."""
    add_materials(root, _MATERIALS)
    _add_trunk(root.find("body", spec.trunk), spec)
    for leg in spec.legs:
        hip, thigh, calf = (root.find("body", link.name) for link in leg.links)
        _add_leg(hip, thigh, calf, leg, spec.kinematics)


def _add_trunk(trunk: mjcf.Element, spec: RobotSpec) -> None:
    """Add body shell, back rail, head, scanner, tail and the four hip motors."""
    box(trunk, "shell", (0, 0, 0.004), (0.165, 0.048, 0.05))
    for side in (-1.0, 1.0):
        rod(trunk, "shell", 0.045, (-0.125, side * 0.038, 0.008), (0.125, side * 0.038, 0.008))
        rod(trunk, "panel", 0.03, (-0.11, side * 0.05, -0.018), (0.11, side * 0.05, -0.018))
        rod(trunk, "metal", 0.006, (-0.1, side * 0.03, 0.058), (0.1, side * 0.03, 0.058))
        box(trunk, "blue", (0.0, side * 0.0825, 0.012), (0.075, 0.0012, 0.004))
    box(trunk, "panel", (0, 0, 0.054), (0.1, 0.022, 0.006))
    box(trunk, "panel", (0, 0, -0.05), (0.13, 0.055, 0.008))

    # Head: a rounded muzzle with camera and lamp, and the scanner below it.
    ellipsoid(trunk, "shell", (0.235, 0, 0.016), (0.1, 0.05, 0.046))
    ellipsoid(trunk, "glass", (0.285, 0, 0.018), (0.054, 0.041, 0.036))
    disc(trunk, "light", 0.009, (0.33, 0, 0.022), (0.3385, 0, 0.021))
    for side in (-1.0, 1.0):
        box(trunk, "light", (0.327, side * 0.018, 0.02), (0.003, 0.006, 0.002))
    disc(trunk, "panel", 0.034, (0.282, 0, -0.024), (0.289, 0, -0.046))
    ball(trunk, "glass", (0.293, 0, -0.056), 0.032)
    ellipsoid(trunk, "shell", (-0.195, 0, 0.008), (0.055, 0.05, 0.042))
    box(trunk, "blue", (-0.247, 0, 0.012), (0.003, 0.02, 0.004))

    kin = spec.kinematics
    for leg in spec.legs:
        x, y = leg.front * kin.hip_x, leg.left * kin.hip_y
        disc(trunk, "panel", 0.044, (x - leg.front * 0.075, y, 0), (x - leg.front * 0.032, y, 0))


def _add_leg(hip: mjcf.Element, thigh: mjcf.Element, calf: mjcf.Element, leg: Leg, kin: LegKinematics) -> None:
    """Add hip housing, thigh with the calf's motor, bent shank and rubber foot of one leg."""
    front, s, knee, foot = leg.front, leg.left, -kin.thigh_length, -kin.calf_length
    disc(hip, "panel", 0.04, (-front * 0.028, 0, 0), (front * 0.036, 0, 0))
    disc(hip, "metal", 0.03, (front * 0.036, 0, 0), (front * 0.04, 0, 0))
    disc(hip, "shell", 0.045, (0, s * 0.02, 0), (0, s * 0.062, 0))

    disc(thigh, "panel", 0.046, (0, -s * 0.03, 0), (0, s * 0.018, 0))
    disc(thigh, "blue", 0.0465, (0, s * 0.008, 0), (0, s * 0.0105, 0))
    disc(thigh, "metal", 0.034, (0, s * 0.018, 0), (0, s * 0.022, 0))
    ellipsoid(thigh, "shell", (-0.006, 0, -0.085), (0.034, 0.018, 0.088))
    rod(thigh, "shell", 0.016, (-0.004, 0, -0.09), (0, 0, knee))
    for side in (-1.0, 1.0):
        disc(thigh, "metal", 0.015, (0, side * 0.016, knee), (0, side * 0.019, knee))

    rod(calf, "panel", 0.0135, (0, 0, 0), (0.0195, 0, -0.107))
    rod(calf, "shell", 0.0115, (0.0195, 0, -0.107), (0.019, 0, -0.169))
    rod(calf, "rubber", 0.014, (0.014, 0, -0.178), (0, 0, foot + 0.006))
    ball(calf, "rubber", (0, 0, foot), kin.foot_radius)
