from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
import torch
from torch import Tensor

from skatemount.envs.geometry import (
    quat_from_euler,
    quat_from_matrix,
    quat_multiply,
    quat_to_matrix,
    rotate,
    rotate_inverse,
)


def random_quats(n: int, seed: int = 0) -> Tensor:
    quats = torch.randn(n, 4, generator=torch.Generator().manual_seed(seed))
    return quats / quats.norm(dim=-1, keepdim=True)


def test_matrices_are_the_engines() -> None:
    quats = random_quats(50)
    expected = np.zeros((50, 9))
    for row, quat in zip(expected, quats.double().numpy()):
        mujoco.mju_quat2Mat(row, quat)
    torch.testing.assert_close(
        quat_to_matrix(quats), torch.from_numpy(expected).float().reshape(50, 3, 3), atol=1e-6, rtol=0
    )


def test_products_are_the_engines() -> None:
    a, b = random_quats(50), random_quats(50, seed=1)
    expected = np.zeros((50, 4))
    for row, left, right in zip(expected, a.double().numpy(), b.double().numpy()):
        mujoco.mju_mulQuat(row, left, right)
    torch.testing.assert_close(quat_multiply(a, b), torch.from_numpy(expected).float(), atol=1e-6, rtol=0)


def test_matrices_give_their_quaternions_back() -> None:
    # Half turns about each axis among them, where a component is 0.
    quats = torch.cat((random_quats(200), torch.eye(4), torch.tensor([[0.0, 0.6, 0.8, 0.0]])))
    back = quat_from_matrix(quat_to_matrix(quats))
    same = back * torch.sign((back * quats).sum(-1, keepdim=True))
    torch.testing.assert_close(same, quats, atol=1e-6, rtol=0)


@pytest.mark.parametrize("shape", [(), (5,), (2, 3)])
def test_matrices_keep_leading_dimensions(shape: tuple[int, ...]) -> None:
    quats = random_quats(math.prod(shape)).reshape(*shape, 4)
    matrices = quat_to_matrix(quats)
    assert matrices.shape == (*shape, 3, 3)
    torch.testing.assert_close(matrices @ matrices.transpose(-1, -2), torch.eye(3).expand(*shape, 3, 3))


def test_euler_angles_turn_yaw_first_then_pitch_then_roll() -> None:
    roll, pitch, yaw = torch.tensor([0.3, -1.1, 0.0]), torch.tensor([-0.4, 0.7, 0.0]), torch.tensor([2.0, -2.9, 0.5])
    got = quat_to_matrix(quat_from_euler(roll, pitch, yaw))
    for matrix, r, p, y in zip(got, roll.tolist(), pitch.tolist(), yaw.tolist()):
        about_x = torch.tensor([[1, 0, 0], [0, math.cos(r), -math.sin(r)], [0, math.sin(r), math.cos(r)]])
        about_y = torch.tensor([[math.cos(p), 0, math.sin(p)], [0, 1, 0], [-math.sin(p), 0, math.cos(p)]])
        about_z = torch.tensor([[math.cos(y), -math.sin(y), 0], [math.sin(y), math.cos(y), 0], [0, 0, 1]])
        torch.testing.assert_close(matrix, about_z @ about_y @ about_x)


@pytest.mark.parametrize("points", [None, 1, 3, 5])
def test_rotating_into_a_frame_undoes_rotating_out_of_it(points: int | None) -> None:
    matrix = quat_to_matrix(random_quats(3))
    shape = (3, 3) if points is None else (3, points, 3)
    vectors = torch.randn(shape, generator=torch.Generator().manual_seed(2))
    world = rotate(matrix, vectors)
    assert world.shape == vectors.shape
    # World by world with plain products, so that three worlds are not mistaken for three axes.
    for m, v, w in zip(matrix, vectors, world):
        torch.testing.assert_close(w, (m @ v.reshape(-1, 3).T).T.reshape(v.shape))
    torch.testing.assert_close(rotate_inverse(matrix, world), vectors, atol=1e-6, rtol=1e-5)
