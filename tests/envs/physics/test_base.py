"""Batches of start states, and the pose of a world for rendering."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch

from skatemount.envs import MountTask
from skatemount.envs.physics.base import StartState, posed_data, where_rows


def starts(count: int, seed: int) -> StartState:
    return MountTask(stage="mount").make_sampler().draw(count, torch.Generator().manual_seed(seed))


def given(start: StartState) -> dict[str, torch.Tensor]:
    """Return the fields that are not None."""
    return {name: value for name, value in vars(start).items() if value is not None}


def test_rows_can_be_taken_and_joined_again() -> None:
    start = starts(7, 0)
    rows = torch.tensor([4, 0])
    assert len(start) == 7 and len(start[rows]) == 2 and len(start[2:5]) == 3
    joined = StartState.cat([start[:3], start[3:]])
    for name, value in given(start).items():
        assert torch.equal(getattr(joined, name), value), name
        assert torch.equal(getattr(start[rows], name), value[rows]), name


def test_rows_are_selected_by_a_mask() -> None:
    first, second = starts(5, 0), starts(5, 1)
    mask = torch.tensor([True, False, False, True, False])
    mixed = StartState.where(mask, first, second)
    for name, value in given(mixed).items():
        assert torch.equal(value[mask], getattr(first, name)[mask]), name
        assert torch.equal(value[~mask], getattr(second, name)[~mask]), name
    assert not torch.equal(mixed.base_pos, second.base_pos)


def test_a_single_row_stands_for_all() -> None:
    mask, default = torch.tensor([True, False]), torch.tensor([1.0, 2.0, 3.0])
    assert where_rows(mask, default, torch.zeros(2, 3)).tolist() == [[1, 2, 3], [0, 0, 0]]


def test_posed_data_is_the_state_with_everything_computed() -> None:
    model = MountTask(stage="mount").scene.compile()
    qpos, qvel = model.qpos0.copy(), np.linspace(0, 1, model.nv)
    qpos[2] = 0.7
    mocap = np.full((model.nmocap, 3), -0.03)
    same, data = posed_data(model, qpos, qvel, mocap)
    assert same is model
    np.testing.assert_array_equal(data.qpos, qpos)
    np.testing.assert_array_equal(data.qvel, qvel)
    floor = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "robot_floor")
    np.testing.assert_allclose(data.xpos[floor], mocap[0])


def test_what_one_batch_leaves_out_is_zero_beside_another() -> None:
    plain, leaning = starts(2, 0), starts(3, 1)
    leaning.board_lean, leaning.truck_angle = torch.full((3,), 0.05), torch.ones(3, 2)
    assert plain.usual_board and not leaning.usual_board
    joined = StartState.cat([plain, leaning])
    assert joined.board_lean.tolist() == pytest.approx([0, 0, 0.05, 0.05, 0.05]) and joined.board_yaw is None
    assert joined.truck_angle.sum(1).tolist() == [0, 0, 2, 2, 2]
    mixed = StartState.where(torch.tensor([True, False]), plain, leaning[:2])
    assert mixed.board_lean.tolist() == pytest.approx([0, 0.05]) and mixed.board_xy is None
    assert leaning[1:].board_lean.shape == (2,) and StartState.cat([plain, plain]).usual_board
