"""One collision shape for each link of a robot that is read from a file."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from skatemount.envs.robots.spec import Box, Capsule, LegKinematics, Vector

_GEOM = mujoco.mjtGeom
_TRUNK_HALF_HEIGHT = 0.05


@dataclass(frozen=True, eq=False)
class Solid:
    """A geom of MuJoCo in the frame of its link.

    Attributes:
        kind: Its type.
        size: Its ``geom_size``, m.
        center: ``[3]`` m.
        axes: ``[3, 3]``, its axes as columns.
        aabb: ``[6]``, center and half sizes of its bounding box in its own frame, m.
    """

    kind: mujoco.mjtGeom
    size: np.ndarray
    center: np.ndarray
    axes: np.ndarray
    aabb: np.ndarray

    @property
    def volume(self) -> float:
        """Volume of the bounding box, m^3."""
        return float(8 * np.prod(self.aabb[3:]))

    def shape(self) -> Box | Capsule:
        """Return a capsule for a capsule or cylinder, and a box along the link's axes for all others.

        The capsule of a cylinder has the same radius and length; it is a ball's width long at least.
        """
        if self.kind in (_GEOM.mjGEOM_CAPSULE, _GEOM.mjGEOM_CYLINDER):
            radius, half = self.size[0], self.size[1]
            if self.kind == _GEOM.mjGEOM_CYLINDER:
                half = max(half - radius, 1e-3)
            along = half * self.axes[:, 2]
            return Capsule(_rounded(radius), _vector(self.center - along), _vector(self.center + along))
        # The box along the link's axes that holds the geom's bounding box, which may be turned.
        return Box(_vector(np.abs(self.axes) @ self.aabb[3:]), _vector(self.center + self.axes @ self.aabb[:3]))


def one_shape(solids: list[Solid], body: str, notes: list[str]) -> Box | Capsule | None:
    """Return the shape of the largest of a link's geoms; None without one.

    Args:
        solids: The geoms, without the foot.
        body: Name of the link.
        notes: A sentence is added if there are several geoms.
    """
    if not solids:
        return None
    if len(solids) > 1:
        notes.append(f"{body} has {len(solids)} collision shapes; the spec has the largest one.")
    return max(solids, key=lambda solid: solid.volume).shape()


def trunk_box(kinematics: LegKinematics, notes: list[str]) -> Box:
    """Return a box between the hips, for a trunk without collision shape."""
    notes.append("The trunk has no collision shape; the spec has a box between the hips.")
    return Box((kinematics.hip_x, kinematics.hip_y + kinematics.thigh_y / 2, _TRUNK_HALF_HEIGHT))


def leg_radius(shape: Box | Capsule | None) -> float:
    """Return how far a thigh's or calf's surface is from the straight line down its middle, m."""
    if shape is None:
        return 0.0
    if isinstance(shape, Capsule):
        return shape.radius + max(float(np.hypot(*end[:2])) for end in (shape.start, shape.end))
    return float(np.hypot(*(abs(c) + h for c, h in zip(shape.center[:2], shape.half_size[:2]))))


def _rounded(value: float) -> float:
    return 0.0 if abs(value) < 1e-9 else float(f"{value:.6g}")


def _vector(values: np.ndarray) -> Vector:
    x, y, z = (_rounded(each) for each in values)
    return x, y, z
