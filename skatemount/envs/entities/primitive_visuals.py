"""Primitive shapes without mass or contact, of which the looks of the robots are made."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dm_control import mjcf

Point = tuple[float, float, float]
Material = tuple[tuple[float, float, float, float], float, float, float]
"""Color with opacity, specular part, shininess and reflectance, each from 0 to 1."""


def add_materials(root: mjcf.RootElement, materials: Mapping[str, Material]) -> None:
    """Add the materials that the shapes refer to, by name."""
    for name, (rgba, specular, shininess, reflectance) in materials.items():
        root.asset.add(
            "material",
            name=name,
            rgba=rgba,
            specular=specular,
            shininess=shininess,
            reflectance=reflectance,
        )


def rod(body: mjcf.Element, material: str, radius: float, start: Point, end: Point) -> None:
    """Add a rod with round ends; its axis goes from start to end, m."""
    add(body, material, type="capsule", size=(radius,), fromto=(*start, *end))


def disc(body: mjcf.Element, material: str, radius: float, start: Point, end: Point) -> None:
    """Add a disc or tube with flat ends; its axis goes from start to end, m."""
    add(body, material, type="cylinder", size=(radius,), fromto=(*start, *end))


def box(body: mjcf.Element, material: str, pos: Point, half_size: Point) -> None:
    """Add a box by its center and half sizes, m."""
    add(body, material, type="box", size=half_size, pos=pos)


def ellipsoid(body: mjcf.Element, material: str, pos: Point, radii: Point) -> None:
    """Add an ellipsoid by its center and radii, m."""
    add(body, material, type="ellipsoid", size=radii, pos=pos)


def ball(body: mjcf.Element, material: str, pos: Point, radius: float) -> None:
    """Add a ball by its center and radius, m."""
    add(body, material, type="sphere", size=(radius,), pos=pos)


def add(body: mjcf.Element, material: str, **shape: Any) -> None:
    """Add a shape of the class ``visual`` by its MJCF attributes."""
    body.add("geom", dclass="visual", material=material, **shape)
