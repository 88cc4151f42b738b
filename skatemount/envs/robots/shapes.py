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
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Center and half sizes of a box along the link's axes that holds the geom, m."""
        if self.kind in (_GEOM.mjGEOM_CAPSULE, _GEOM.mjGEOM_CYLINDER):
            # Of a cylinder this holds a ball at either end, not the rims, which may be a little outside.
            straight = self.size[1] - (self.size[0] if self.kind == _GEOM.mjGEOM_CYLINDER else 0.0)
            return self.center, self.size[0] + max(straight, 0.0) * np.abs(self.axes[:, 2])
        return self.center + self.axes @ self.aabb[:3], np.abs(self.axes) @ self.aabb[3:]

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
        center, half = self.bounds
        return Box(_vector(half), _vector(center))


def one_shape(solids: list[Solid], lowest: float) -> Box | Capsule | None:
    """Return one shape for all geoms of a link; None without geoms.

    A single geom keeps its shape. Of several it is the box that holds them, or a capsule inside of that box if the box
    is long.

    Args:
        solids: The geoms, without the foot.
        lowest: Lowest height of a capsule's surface in the link's frame, m, which keeps a calf off the ground.
    """
    if len(solids) < 2:
        return solids[0].shape() if solids else None
    bounds = [solid.bounds for solid in solids]
    low = np.min([center - half for center, half in bounds], axis=0)
    high = np.max([center + half for center, half in bounds], axis=0)
    center, half = (low + high) / 2, (high - low) / 2
    width, longest = sorted(half)[1:]
    if longest < 2 * width or int(np.argmax(half)) != 2:
        return Box(_vector(half), _vector(center))
    bottom = max(low[2], lowest) + width
    x, y = center[:2]
    return Capsule(_rounded(width), _vector(np.array([x, y, high[2] - width])), _vector(np.array([x, y, bottom])))


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
    x, y = (abs(c) + h for c, h in zip(shape.center[:2], shape.half_size[:2]))
    return float(np.hypot(x, y))


def _rounded(value: float) -> float:
    return 0.0 if abs(value) < 1e-9 else float(f"{value:.6g}")


def _vector(values: np.ndarray) -> Vector:
    x, y, z = (_rounded(each) for each in values)
    return x, y, z
