"""Constructed states: a robot and a board put anywhere, with every frame's numbers consistent."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import defaults
import numpy as np
import pytest
import torch

from skatemount.envs.geometry import board_direction
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.terms import TaskContext

Numbers = tuple[float, ...]

STANCE = [0.15, 0.8, -1.5, -0.15, 0.8, -1.5] * 2
NOMINAL_FEET = [[0.2, -0.1, -0.28], [0.2, 0.1, -0.28], [-0.16, -0.1, -0.28], [-0.16, 0.1, -0.28]]


def rotation(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """Rz(yaw) Ry(pitch) Rx(roll), written out so that it shares nothing with the package."""
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def _state(
    base: Numbers = (0.0, 0.0, 0.388),
    base_rpy: Numbers = (0.0, 0.0, 0.0),
    board: Numbers = (0.0, 0.0, 0.088),
    board_rpy: Numbers = (0.0, 0.0, 0.0),
    **fields: Any,
) -> SimState:
    """One world, still and touching nothing but for what `fields` says (values without the batch dimension)."""
    p, r = np.array(base), rotation(*base_rpy)
    b, s = np.array(board), rotation(*board_rpy)
    feet = p + np.array(NOMINAL_FEET) @ r.T if "foot_pos" not in fields else np.array(fields["foot_pos"])
    values: dict[str, Any] = dict(
        base_pos=p,
        base_rot=r,
        base_lin_vel=np.zeros(3),
        base_ang_vel=np.zeros(3),
        gravity=r.T @ (0.0, 0.0, -1.0),
        joint_pos=STANCE,
        joint_vel=np.zeros(12),
        joint_acc=np.zeros(12),
        joint_torque=np.zeros(12),
        foot_pos=feet,
        foot_vel=np.zeros((4, 3)),
        foot_pos_base=(feet - p) @ r,
        foot_pos_board=(feet - b) @ s,
        foot_vel_board=np.zeros((4, 3)),
        foot_deck_force=np.zeros((4, 3)),
        foot_other_force=np.zeros((4, 3)),
        body_force=np.zeros(13),
        board_pos=b,
        board_rot=s,
        board_lin_vel=np.zeros(3),
        board_ang_vel=np.zeros(3),
        board_pos_base=r.T @ (b - p),
        board_rot_base=r.T @ s,
        truck_angle=np.zeros(2),
        wheel_speed=np.zeros(4),
        ground_height=0.0,
    )
    fixed = torch.tensor([fields.pop("board_fixed", True)])
    values |= fields
    tensors = {name: torch.as_tensor(np.array(value, dtype=np.float32)).unsqueeze(0) for name, value in values.items()}
    return SimState(**tensors, board_fixed=fixed, batch_size=[1])


def _episode(sim: SimState | None = None, **fields: Any) -> EpisodeState:
    """One episode that has just begun but for what `fields` says; with `sim`, at its distance from the board."""
    episode = EpisodeState.zeros(1, defaults.LAYOUT)
    if sim is not None:
        distance = torch.linalg.vector_norm(sim.board_pos[:, :2] - sim.base_pos[:, :2], dim=-1)
        episode.distance = episode.previous_distance = distance
        episode.board_direction = board_direction(sim.board_rot_base)
    for name, value in fields.items():
        like = getattr(episode, name)
        setattr(episode, name, torch.as_tensor(np.array(value)).to(like.dtype).reshape(like.shape))
    return episode


@pytest.fixture
def make_state() -> Callable[..., SimState]:
    """A world's state: `make_state(base, base_rpy, board, board_rpy, **fields)`."""
    return _state


@pytest.fixture
def make_episode() -> Callable[..., EpisodeState]:
    """A world's episode: `make_episode(sim, **fields)`."""
    return _episode


@pytest.fixture
def context() -> TaskContext:
    """Constants of the default scene in round numbers."""
    limits = torch.tensor([[-0.7, 0.7], [-0.8, 3.9], [-2.6, -1.0]]).repeat(4, 1)
    return TaskContext(
        control_step=0.04,
        layout=defaults.LAYOUT,
        default_pose=torch.tensor(STANCE),
        soft_limits=limits,
        deck_half=(0.2875, 0.125),
        deck_height=0.088,
        wheels_half=(0.2485, 0.079),
        foot_radius=0.02,
        stance_height=0.3,
        episode_steps=125,
    )


@pytest.fixture
def make_context(context: TaskContext) -> Callable[..., TaskContext]:
    """The same constants with some of them changed."""
    return lambda **changes: dataclasses.replace(context, **changes)
