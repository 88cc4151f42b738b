"""Models of the boards of many worlds: each board is compiled in its scene, and its values are copied to its world."""

from __future__ import annotations

import mujoco
import numpy as np
import torch
from torch import Tensor

from skatemount.envs.boards import Boards
from skatemount.envs.entities.skateboard import resize
from skatemount.envs.physics.base import Physics
from skatemount.envs.scene import Scene

BOARD_FIELDS = (
    "body_pos",
    "body_mass",
    "body_subtreemass",
    "body_inertia",
    "body_invweight0",
    "bvh_aabb",
    "dof_M0",
    "dof_invweight0",
    "dof_length",
    "eq_data",
    "geom_aabb",
    "geom_rbound",
    "geom_size",
    "jnt_axis",
    "jnt_stiffness",
    "qpos0",
    "qpos_spring",
)
"""Model fields in which two boards differ, without those that only cameras and lights read."""


class BoardModels:
    """A compiler of scenes that differ in the board only.

    The scene is written as XML and parsed once. To compile it with another board then takes about a millisecond, where
    building it from composer entities takes more than a hundred.

    Args:
        scene: The scene.
    """

    def __init__(self, scene: Scene):
        self._spec = mujoco.MjSpec.from_string(scene.xml())
        self._name = scene.board.mjcf_model.model

    def fields(self, boards: Boards) -> dict[str, np.ndarray]:
        """Compile the scene with every board.

        Args:
            boards: The boards of N worlds.

        Returns:
            ``[N, ...]`` float64 values by name of the field, for each name in `BOARD_FIELDS`.
        """
        different = boards.different
        rows: dict[str, list[np.ndarray]] = {name: [] for name in BOARD_FIELDS}
        for board in different:
            resize(self._spec, self._name, board)
            model = self._spec.compile()
            for name, values in rows.items():
                values.append(getattr(model, name).copy())
        place = {id(board): i for i, board in enumerate(different)}
        of_world = [place[id(board)] for board in boards.of_world]
        return {name: np.stack(values)[of_world] for name, values in rows.items()}

    def give(self, physics: Physics, boards: Boards) -> dict[str, Tensor]:
        """Give every world its board, with nominal values: nothing is randomized.

        Args:
            physics: The worlds.
            boards: Their boards.

        Returns:
            ``[N, ...]`` nominal values by name of the field, on the device of the worlds.
        """
        values = self.fields(boards)
        physics.set_boards(boards, values)
        return {name: torch.from_numpy(value).to(physics.device) for name, value in values.items()}
