"""The left-right mirror image of observations and actions, as a permutation and signs.

Robot and board are symmetric about the trunk's xz plane. Under y -> -y, polar vectors change the sign of y, axial
vectors (angular velocities) change the signs of x and z, right legs become left legs, and hip angles change sign.
"""

from __future__ import annotations

import torch
from torch import Tensor

_LEGS = torch.tensor([1, 0, 3, 2])
_POLAR = torch.tensor([1.0, -1.0, 1.0])
_AXIAL = -_POLAR


def _legs(per_leg: int) -> Tensor:
    return (_LEGS.unsqueeze(1) * per_leg + torch.arange(per_leg)).flatten()


def mirror_map(kind: str, size: int) -> tuple[Tensor, Tensor]:
    """Return the permutation and signs of one block: ``mirrored = x[:, permutation] * signs``.

    Args:
        kind: ``vector`` (polar vectors), ``axial``, ``vector_axial``, ``command`` (vx, vy, wz), ``joints``, ``feet``,
            ``flags`` (one value per foot), ``flags_twice``, ``bodies`` (trunk, then hip, thigh and calf of each leg),
            ``outline`` (points around the deck from the middle of its front), ``negative`` or ``scalars``.
        size: Number of values in the block.

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
    if kind == "joints":
        return _legs(3), torch.tensor([-1.0, 1.0, 1.0]).repeat(4)
    if kind == "feet":
        return _legs(3), _POLAR.repeat(4)
    if kind == "flags":
        return _legs(1), ones
    if kind == "flags_twice":
        return torch.cat((_legs(1), _legs(1) + 4)), ones
    if kind == "bodies":
        return torch.cat((torch.zeros(1, dtype=torch.int64), _legs(3) + 1)), ones
    if kind == "outline":
        points = size // 3
        order = (-torch.arange(points)).remainder(points)
        return (order.unsqueeze(1) * 3 + torch.arange(3)).flatten(), _POLAR.repeat(points)
    if kind == "negative":
        return same, -ones
    if kind == "scalars":
        return same, ones
    raise ValueError(f"unknown kind of mirror {kind!r}")
