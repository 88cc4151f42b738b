"""Rotations and frames on batches of torch tensors.

Quaternions are ``w x y z`` and of unit length, shape ``[..., 4]``. Rotation matrices, shape ``[..., 3, 3]``, map
vectors of the named frame to the world: their columns are the frame's axes.
"""

from __future__ import annotations

import torch
from torch import Tensor


def quat_to_matrix(quat: Tensor) -> Tensor:
    """Convert unit quaternions to rotation matrices.

    Args:
        quat: ``[..., 4]``, ``w x y z``.

    Returns:
        ``[..., 3, 3]``.
    """
    w, x, y, z = quat.unbind(-1)
    x2, y2, z2 = 2 * x, 2 * y, 2 * z
    xx, yy, zz = x * x2, y * y2, z * z2
    xy, xz, yz = x * y2, x * z2, y * z2
    wx, wy, wz = w * x2, w * y2, w * z2
    entries = [1 - yy - zz, xy - wz, xz + wy, xy + wz, 1 - xx - zz, yz - wx, xz - wy, yz + wx, 1 - xx - yy]
    return torch.stack(entries, -1).unflatten(-1, (3, 3))


def quat_from_matrix(matrix: Tensor) -> Tensor:
    """Convert rotation matrices to unit quaternions, the inverse of `quat_to_matrix` up to sign.

    Of the four ways to solve for a quaternion, this takes the one that divides by the largest component (Shepperd,
    "Quaternion from Rotation Matrix", 1978).

    Args:
        matrix: ``[..., 3, 3]``.

    Returns:
        ``[..., 4]``, ``w x y z``.
    """
    (a, b, c), (d, e, f), (g, h, i) = (row.unbind(-1) for row in matrix.unbind(-2))
    # 4 q q^T: each row is the quaternion times four of its components.
    rows = (
        (1 + a + e + i, h - f, c - g, d - b),
        (h - f, 1 + a - e - i, b + d, c + g),
        (c - g, b + d, 1 - a + e - i, f + h),
        (d - b, c + g, f + h, 1 - a - e + i),
    )
    products = torch.stack([torch.stack(row, -1) for row in rows], -2)
    largest = products.diagonal(dim1=-2, dim2=-1).argmax(-1)
    chosen = products.gather(-2, largest[..., None, None].expand(*largest.shape, 1, 4)).squeeze(-2)
    return chosen / torch.linalg.vector_norm(chosen, dim=-1, keepdim=True)


def quat_multiply(a: Tensor, b: Tensor) -> Tensor:
    """Multiply quaternions (Hamilton product): the rotation ``b`` followed by the rotation ``a``.

    Args:
        a: ``[..., 4]``.
        b: ``[..., 4]``.

    Returns:
        ``[..., 4]``.
    """
    aw, ax, ay, az = a.unbind(-1)
    bw, bx, by, bz = b.unbind(-1)
    return torch.stack(
        (
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ),
        -1,
    )


def quat_from_euler(roll: Tensor, pitch: Tensor, yaw: Tensor) -> Tensor:
    """Convert intrinsic rotations yaw (z), pitch (y), roll (x) to quaternions.

    Args:
        roll: Angles of any shape, rad.
        pitch: Angles of the same shape, rad.
        yaw: Angles of the same shape, rad.

    Returns:
        ``[..., 4]``.
    """
    zero = torch.zeros_like(yaw)

    def about(axis: int, angle: Tensor) -> Tensor:
        parts = [torch.cos(angle / 2), zero, zero, zero]
        parts[axis + 1] = torch.sin(angle / 2)
        return torch.stack(parts, -1)

    return quat_multiply(quat_multiply(about(2, yaw), about(1, pitch)), about(0, roll))


def rotate(matrix: Tensor, vectors: Tensor) -> Tensor:
    """Rotate vectors from a frame to the world.

    Args:
        matrix: ``[N, 3, 3]``.
        vectors: ``[N, 3]`` or ``[N, K, 3]``, in the frame.

    Returns:
        The same shape, in the world.
    """
    if vectors.dim() == matrix.dim() - 1:
        return (matrix * vectors.unsqueeze(-2)).sum(-1)
    return vectors @ matrix.transpose(-1, -2)


def rotate_inverse(matrix: Tensor, vectors: Tensor) -> Tensor:
    """Rotate vectors from the world to a frame.

    Args:
        matrix: ``[N, 3, 3]``.
        vectors: ``[N, 3]`` or ``[N, K, 3]``, in the world.

    Returns:
        The same shape, in the frame.
    """
    if vectors.dim() == matrix.dim() - 1:
        return (matrix * vectors.unsqueeze(-1)).sum(-2)
    return vectors @ matrix


ACROSS = 0.25
"""Sine of the angle beyond perpendicular that the trunk must turn before the board's other end becomes its front."""


def board_direction(rotation: Tensor, before: Tensor | None = None) -> Tensor:
    """Choose the end of the board that counts as its front: the one that the trunk faces.

    A board has no front of its own. The choice has hysteresis, because without it the observed board would flip back
    and forth when a robot that stands across it sways.

    Args:
        rotation: ``[N, 3, 3]`` the board's axes in the trunk frame (columns).
        before: ``[N, 1]`` the previous choice, which stays until the trunk clearly faces the other end. None at the
            start of an episode.

    Returns:
        ``[N, 1]``, 1 or -1: the factor of the board's x and y axes.
    """
    ahead = rotation[:, 0, :1]
    if before is None:
        return torch.where(ahead < 0, -1.0, 1.0)
    return torch.where(ahead * before < -ACROSS, -before, before)


def beyond_rectangle(xy: Tensor, half: tuple[float | Tensor, float | Tensor]) -> tuple[Tensor, Tensor]:
    """Compute the distances of points beyond a rectangle about the origin along each axis, negative inside.

    Args:
        xy: ``[..., 2]`` m; further columns are ignored.
        half: Half length (x) and half width (y), m: numbers, or tensors that broadcast to ``[...]``.

    Returns:
        ``[...]`` m along x, and ``[...]`` m along y.
    """
    return xy[..., 0].abs() - half[0], xy[..., 1].abs() - half[1]
