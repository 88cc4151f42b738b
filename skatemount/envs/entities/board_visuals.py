"""Looks of a skateboard: deck with kicks and grip tape, trucks, wheels.

None of the geoms has mass or contacts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from dm_control import mjcf

from skatemount.envs.config.board import SkateboardConfig

VISUAL_GROUP = 2

_KICK_STATIONS = 12
_TIP_WIDTH = 0.12  # share of the width: a blunt tip keeps the end faces from degenerating
_GRIP_THICKNESS = 0.0015
_PLATE_HALF_SIZE = (0.042, 0.028, 0.004)


def deck_mesh(
    length: float,
    width: float,
    top: float,
    thickness: float,
    kick_length: float,
    kick_angle: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return a slab with straight sides over ``length`` and a rounded, upward bent kick at both ends.

    Args:
        length: length of the flat part, m.
        width: width, m.
        top: height of the flat part's upper face, m.
        thickness: of the slab, m.
        kick_length: length of each kick beyond the flat part, m; 0 gives a plain box.
        kick_angle: slope at the kicks' ends, rad.

    Returns:
        Vertices ``[4 n, 3]`` in meters and faces ``[8 n - 4, 3]``, a closed surface with outward
        normals, where n counts the cross-sections along the deck.
    """
    half = length / 2
    x = np.array([-half, half])
    if kick_length > 0:
        # Cross-sections close up towards the tip, where the outline turns fastest.
        end = half + kick_length * np.sin(np.linspace(0, np.pi / 2, _KICK_STATIONS + 1))[1:]
        x = np.concatenate([-end[::-1], x, end])
    beyond = np.clip(np.abs(x) - half, 0.0, None)
    share = beyond / (kick_length or 1.0)
    half_width = width / 2 * np.maximum((1 - share**2.3).clip(0) ** (1 / 2.3), _TIP_WIDTH)
    bend = 0.5 * (kick_length or 1.0)  # the slope grows over this length, then stays
    rise = np.where(beyond < bend, beyond**2 / (2 * bend), beyond - bend / 2)
    z = top + np.tan(kick_angle) * rise

    under = z - thickness
    corners = [(-half_width, z), (half_width, z), (half_width, under), (-half_width, under)]
    vertices = np.stack([np.stack([x, y, height], -1) for y, height in corners], 1).reshape(-1, 3)
    faces = [(0, 1, 2), (0, 2, 3)]
    for near in range(0, 4 * (len(x) - 1), 4):
        far = near + 4
        for corner in range(4):
            following = (corner + 1) % 4
            faces.append((near + corner, far + corner, far + following))
            faces.append((near + corner, far + following, near + following))
    last = 4 * (len(x) - 1)
    faces += [(last, last + 2, last + 1), (last, last + 3, last + 2)]
    return vertices, np.array(faces)


def add_materials(root: mjcf.RootElement, config: SkateboardConfig) -> None:
    """Add the materials and the geom class ``visual`` that the other functions use."""
    visual = root.default.add("default", dclass="visual").geom
    visual.set_attributes(contype=0, conaffinity=0, group=VISUAL_GROUP, mass=0)
    for name, rgb, shine in (
        ("wood", config.deck_color, 0.25),
        ("grip", [0.92 * each for each in config.deck_color], 0.05),
        ("wheel", config.wheel_color, 0.5),
        ("core", (0.96, 0.95, 0.92), 0.4),
        ("metal", (0.72, 0.74, 0.77), 0.8),
        ("dark", (0.30, 0.31, 0.34), 0.5),
    ):
        root.asset.add("material", name=name, rgba=(*rgb, 1.0), specular=shine, shininess=shine, reflectance=0)


def add_deck(root: mjcf.RootElement, config: SkateboardConfig) -> None:
    """Add the wooden deck and the clear grip tape on it to the root body."""
    wood = (config.deck_width, -_GRIP_THICKNESS, config.deck_thickness - _GRIP_THICKNESS)
    grip = (config.deck_width - 0.002, 0.0, _GRIP_THICKNESS)
    for name, slab in (("wood", wood), ("grip", grip)):
        vertices, faces = deck_mesh(config.deck_length, *slab, config.kick_length, math.radians(config.kick_angle))
        root.asset.add("mesh", name=name, vertex=vertices.ravel(), face=faces.ravel(), smoothnormal=False)
        root.worldbody.add("geom", dclass="visual", type="mesh", mesh=name, material=name)


def add_truck_mount(root: mjcf.RootElement, config: SkateboardConfig, pivot: np.ndarray, axis: np.ndarray) -> None:
    """Add base plate, kingpin and bushing between deck and truck to the root body.

    Args:
        root: the board's model.
        config: of the board.
        pivot: ``[3]``, the truck's pivot in the board frame, m.
        axis: ``[3]``, unit vector of the steering axis, pointing up.
    """
    body = root.worldbody
    reach = (config.roll_axis_depth - config.deck_thickness) / axis[2]
    head = pivot + min(reach, 1.4 * config.wheel_radius) * axis
    _rod(body, pivot, head, 0.011, "wheel")
    _rod(body, pivot - 0.6 * config.wheel_radius * axis, head, 0.005, "dark")
    plate_z = -config.deck_thickness - _PLATE_HALF_SIZE[2]
    post = (0.024, 0.018, max(0.4 * (head[2] - pivot[2]), 0.004))
    post_z = plate_z - _PLATE_HALF_SIZE[2] - post[2]
    for size, z, material in ((_PLATE_HALF_SIZE, plate_z, "dark"), (post, post_z, "metal")):
        body.add(
            "geom",
            dclass="visual",
            type="box",
            size=size,
            pos=(pivot[0], 0, z),
            material=material,
        )


def add_truck(truck: mjcf.Element, config: SkateboardConfig) -> None:
    """Add hanger and axle to a truck's body."""
    hanger = (config.track - config.wheel_width) / 2
    reach = (config.track + config.wheel_width) / 2 + 0.006
    _rod(truck, (0, -hanger, 0), (0, hanger, 0), 0.36 * config.wheel_radius, "metal")
    _rod(truck, (0, -reach, 0), (0, reach, 0), 0.004, "dark")
    truck.add(
        "geom",
        dclass="visual",
        type="ellipsoid",
        size=(0.016, 0.6 * hanger, 0.016),
        material="metal",
    )


def add_wheel(wheel: mjcf.Element, config: SkateboardConfig) -> None:
    """Add tire and core to a wheel's body, and a mark off the axle that shows that it rolls."""
    half, radius = config.wheel_width / 2, config.wheel_radius
    mark = 0.68 * radius
    for reach, size, offset, material in (
        (0.8 * half, radius, 0.0, "wheel"),
        (half, 0.86 * radius, 0.0, "wheel"),
        (1.03 * half, 0.5 * radius, 0.0, "core"),
        (1.02 * half, 0.1 * radius, mark, "core"),
    ):
        _rod(wheel, (offset, -reach, 0), (offset, reach, 0), size, material, "cylinder")


def _rod(
    body: mjcf.Element,
    start: Sequence[float] | np.ndarray,
    end: Sequence[float] | np.ndarray,
    radius: float,
    material: str,
    kind: str = "capsule",
) -> None:
    body.add(
        "geom",
        dclass="visual",
        type=kind,
        fromto=np.concatenate([start, end]),
        size=(radius,),
        material=material,
    )
