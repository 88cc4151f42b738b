"""The left-right mirror image of observations and actions, as a permutation and signs.

Robot and board are symmetric about the trunk's xz plane. Under y -> -y, polar vectors change the sign of y, axial
vectors (angular velocities) change the signs of x and z, right legs become left legs, and angles about x or z change
sign.
"""

from __future__ import annotations

import torch
from torch import Tensor

from skatemount.envs.robots.layout import JointLayout

KINDS = {
    "vector": "polar vectors (positions, velocities, forces), three values each: y changes its sign",
    "axial": "axial vectors (angular velocities), three values each: x and z change their signs",
    "vector_axial": "a polar and an axial vector, six values",
    "command": "velocity command (forward, left, turn left): left and turn change their signs",
    "ride": "command of a ride (phase, speed, curvature): curvature changes its sign",
    "joints": "one value for each joint: the legs change sides, and angles about x or z change their signs",
    "feet": "a polar vector for each foot: the legs change sides, and y changes its sign",
    "flags": "one value for each foot: the legs change sides",
    "flags_twice": "one value for each foot, then a second one for each foot: the legs change sides in both",
    "bodies": "one value for each body: the bodies of the legs change sides",
    "outline": "points around the deck, three values each, from the middle of its front: left and right change places",
    "negative": "values that change their signs, such as the angles of the trucks",
    "scalars": "values that stay as they are, such as heights",
}
"""Kinds of mirror images of an observation, with their meanings."""

_POLAR = torch.tensor([1.0, -1.0, 1.0])
_AXIAL = -_POLAR


def _legs(layout: JointLayout, per_leg: int) -> Tensor:
    return (torch.tensor(layout.mirror_legs).unsqueeze(1) * per_leg + torch.arange(per_leg)).flatten()


def mirror_map(kind: str, size: int, layout: JointLayout) -> tuple[Tensor, Tensor]:
    """Return the permutation and signs of one block: ``mirrored = x[:, permutation] * signs``.

    Args:
        kind: A key of `KINDS`.
        size: Number of values in the block.
        layout: Order of the robot's joints, feet and bodies.

    Returns:
        The permutation, ``[size]`` int64, and the signs, ``[size]`` float32.

    Raises:
        ValueError: The kind is unknown.
    """
    same, ones = torch.arange(size), torch.ones(size)
    if kind == "vector":
        return same, _POLAR.repeat(size // 3)
    if kind == "axial":
        return same, _AXIAL.repeat(size // 3)
    if kind == "vector_axial":
        return same, torch.cat((_POLAR, _AXIAL))
    if kind == "command":
        return same, torch.tensor([1.0, -1.0, -1.0])
    if kind == "ride":
        return same, torch.tensor([1.0, 1.0, -1.0])
    if kind == "joints":
        return torch.tensor(layout.mirror_joints), torch.tensor(layout.joint_signs)
    if kind == "feet":
        return _legs(layout, 3), _POLAR.repeat(layout.num_feet)
    if kind == "flags":
        return _legs(layout, 1), ones
    if kind == "flags_twice":
        return torch.cat((_legs(layout, 1), _legs(layout, 1) + layout.num_feet)), ones
    if kind == "bodies":
        return torch.tensor(layout.mirror_bodies), ones
    if kind == "outline":
        points = size // 3
        order = (-torch.arange(points)).remainder(points)
        return (order.unsqueeze(1) * 3 + torch.arange(3)).flatten(), _POLAR.repeat(points)
    if kind == "negative":
        return same, -ones
    if kind == "scalars":
        return same, ones
    raise ValueError(f"unknown kind of mirror {kind!r}")
