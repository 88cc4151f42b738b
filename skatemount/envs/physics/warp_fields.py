"""Model fields that have a value for each world in mujoco_warp, where all others are the same in every world."""

from __future__ import annotations

import mujoco
import numpy as np
import torch
from torch import Tensor

from skatemount.envs.physics import target_history
from skatemount.envs.physics.board_models import BOARD_FIELDS

_OF_WORLDS = (
    "geom_friction",
    "jnt_stiffness",
    "dof_frictionloss",
    "body_mass",
    "body_inertia",
    "body_ipos",
    "actuator_gainprm",
    "actuator_forcerange",
)
_DERIVED = ("body_subtreemass", "body_invweight0", "dof_invweight0", "actuator_acc0")
"""Fields that are computed from masses and inertias."""
_UNUSED = ("bvh_aabb", "dof_M0", "dof_length")
"""Fields that only the C engine reads, or only for sleeping bodies."""
OF_BOARDS = tuple(name for name in BOARD_FIELDS if name not in _UNUSED)
"""Fields that differ from board to board."""


def settable(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the fields that the environment may change in single worlds."""
    return (*_OF_WORLDS, *target_history.fields(model))


def of_each_world(model: mujoco.MjModel, boards_vary: bool) -> tuple[str, ...]:
    """Return the fields that need a value for each world.

    Args:
        model: The compiled scene.
        boards_vary: True if the worlds' boards differ.
    """
    return tuple(dict.fromkeys((*settable(model), *_DERIVED, *(OF_BOARDS if boards_vary else ()))))


def write(own: Tensor, values: np.ndarray) -> None:
    """Write the values of a field of MuJoCo, ``[N, ...]``, to mujoco_warp's, which may have more columns."""
    given = torch.from_numpy(values).to(own)
    own[..., : given.shape[-1]] = given.view(len(given), *own.shape[1:-1], -1)


def read(own: Tensor, i: int, like: np.ndarray) -> np.ndarray:
    """Return a world's values of mujoco_warp's field in the shape of MuJoCo's.

    Args:
        own: ``[N, ...]`` or, if it is the same in every world, ``[1, ...]``.
        i: The world.
        like: The field of MuJoCo's model.
    """
    row = own[i % len(own)].cpu().numpy()
    if row.size != like.size:
        row = row[..., : like.shape[-1]]
    return np.asarray(row.reshape(like.shape))
