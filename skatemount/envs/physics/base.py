"""The interface between the environment and a physics engine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import mujoco
import numpy as np
import torch
from torch import Tensor

from skatemount.envs.boards import Boards
from skatemount.envs.config.board import SkateboardConfig
from skatemount.envs.scene import Scene, SceneIndex
from skatemount.envs.state import SimState


class Physics(Protocol):
    """An engine that steps N worlds of one scene.

    Tensors are float32 unless the description says otherwise.

    Attributes:
        num_worlds: Number of worlds, N.
        device: Device of the states, and of the tensors that the methods take.
        model: The compiled scene with its nominal values.
        index: Ids and slices of the scene.
        description: The engine and its device or threads, in a few words.
    """

    num_worlds: int
    device: torch.device
    model: mujoco.MjModel
    index: SceneIndex
    description: str

    def step(self, targets: Tensor, substeps: int) -> None:
        """Advance every world by ``substeps`` physics steps.

        Args:
            targets: ``[N, J]`` joint position targets, rad.
            substeps: Number of physics steps.
        """
        ...

    def reset(self, mask: Tensor, start: StartState) -> None:
        """Put the chosen worlds into start states and compute everything that depends on them.

        Args:
            mask: ``[N]`` bool.
            start: One start state for each chosen world, in order.
        """
        ...

    def push(self, mask: Tensor, velocity: Tensor, board: bool = False) -> None:
        """Add to the velocity of the trunk, or of the deck, in the chosen worlds.

        Args:
            mask: ``[N]`` bool.
            velocity: ``[N, 3]`` world axes, m/s.
            board: True for the deck, whose wheels keep their speed and slip until the floor has turned them.
        """
        ...

    def pull_board(self, force: Tensor) -> None:
        """Set the force on the board, which acts at the deck's center of mass until the next call or reset.

        Args:
            force: ``[N, 3]`` world axes, N.
        """
        ...

    def state(self, rows: Tensor | None = None) -> SimState:
        """Return the state of every world, or of some.

        Args:
            rows: ``[K]`` int64, the worlds to return; all if None.

        Returns:
            ``[N]`` or ``[K]`` states, whose tensors share no memory with the engine.
        """
        ...

    def field(self, name: str) -> Tensor:
        """Return the ``[N, ...]`` values of a model field, which writes change from the next step or reset on."""
        ...

    def set_boards(self, boards: Boards, fields: dict[str, np.ndarray]) -> None:
        """Give every world a board of its own; all that follows, from the next reset on, is of that board.

        Only for a scene whose boards vary.

        Args:
            boards: The boards of the worlds.
            fields: ``[N, ...]`` model fields of the boards; see `skatemount.envs.physics.board_models.BOARD_FIELDS`.
        """
        ...

    def refresh_constants(self) -> None:
        """Recompute the model constants that depend on masses and inertias, after a change of these through `field`."""
        ...

    def diverged(self) -> Tensor:
        """Return ``[N]`` bool: worlds whose physics failed (not finite or out of bounds) since their last reset."""
        ...

    def render_data(self, i: int) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """Return a model with visuals, and data with one world's pose, to render it.

        Args:
            i: Index of the world.
        """
        ...

    def poses(self, worlds: slice) -> tuple[np.ndarray, np.ndarray]:
        """Return copies of ``qpos`` ``[K, nq]`` and ``mocap_pos`` ``[K, nmocap, 3]`` of some worlds, for films."""
        ...

    def overflowed(self) -> str | None:
        """Return an error message if contacts were dropped since the last call, else None.

        Contacts are dropped when a buffer is too small. The message names the setting to raise.
        """
        ...

    def raw_state(self) -> Any:
        """Return a copy of every world's full integration state, for `set_raw_state`."""
        ...

    def set_raw_state(self, state: Any) -> None:
        """Restore a state from `raw_state` and compute everything that depends on it."""
        ...

    def world(self, i: int, state: Any) -> tuple[mujoco.MjModel, dict[str, np.ndarray]]:
        """Return a copy of a world's model, with the fields of its own, and its part of a state.

        Args:
            i: Index of the world.
            state: From `raw_state`.

        Returns:
            The model, and copies of the state's arrays by their names in ``MjData``.
        """
        ...

    def state_dict(self) -> dict[str, Tensor]:
        """Return copies of everything that a step or a reset depends on, the model fields of each world included."""
        ...

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restore what `state_dict` returned; on the CPU, all that follows is the same to the bit."""
        ...

    def close(self) -> None:
        """Free the engine's memory and threads."""
        ...


@dataclass
class StartState:
    """Start states of N worlds: pose and velocity of robot and board.

    The board's long axis is level. A field of the board that is None stands for zeros: a level board at the origin,
    along the x axis, that rolls straight on with all wheels on its floor.

    Attributes:
        base_pos: ``[N, 3]`` trunk center, world, m.
        base_quat: ``[N, 4]`` rotation from the trunk frame to the world, ``w x y z``.
        base_lin_vel: ``[N, 3]`` world, m/s.
        base_ang_vel: ``[N, 3]`` trunk frame, rad/s.
        joint_pos: ``[N, J]`` rad.
        joint_vel: ``[N, J]`` rad/s.
        ground_height: ``[N]`` height of the robot's floor, m.
        board_fixed: ``[N]`` bool, the deck is welded to the world.
        board_speed: ``[N]`` speed of the deck's center along the board's heading, m/s; 0 where it is fixed. The wheels
            roll without slip.
        force: ``[N, 3]`` constant force on the trunk for the episode, world, N.
        torque: ``[N, 3]`` constant torque on the trunk, world, N m.
        bin: ``[N]`` int64, the curriculum bin of the start state, -1 for none. Engines ignore it.
        board_xy: ``[N, 2]`` deck center, world, m.
        board_lift: ``[N]`` height of the deck's center above the one at which all wheels of a board with this lean
            stand on the floor, m.
        board_yaw: ``[N]`` heading of the board in the world, rad.
        board_yaw_rate: ``[N]`` turning rate of the board about the vertical, rad/s; `yaw_rate_of_lean` gives the one at
            which no wheel slips sideways.
        board_lean: ``[N]`` roll of the deck about its long axis, rad; positive to the right.
        truck_angle: ``[N, 2]`` front and rear truck about their axes, rad; `trucks_of_lean` gives those at which all
            wheels stand on the floor.
        world: ``[N]`` int64, the world whose board the state fits; None if all worlds have the same board. Engines
            ignore it.
    """

    base_pos: Tensor
    base_quat: Tensor
    base_lin_vel: Tensor
    base_ang_vel: Tensor
    joint_pos: Tensor
    joint_vel: Tensor
    ground_height: Tensor
    board_fixed: Tensor
    board_speed: Tensor
    force: Tensor
    torque: Tensor
    bin: Tensor
    board_xy: Tensor | None = None
    board_lift: Tensor | None = None
    board_yaw: Tensor | None = None
    board_yaw_rate: Tensor | None = None
    board_lean: Tensor | None = None
    truck_angle: Tensor | None = None
    world: Tensor | None = None

    @property
    def usual_board(self) -> bool:
        """True if every board starts level at the origin, along the x axis, and rolls straight on."""
        return all(getattr(self, name) is None for name in _BOARD)

    def map(self, function: Callable[[Tensor], Tensor]) -> StartState:
        """Apply a function to every tensor; fields that are None stay None."""
        fields: dict[str, Any] = {n: v if v is None else function(v) for n, v in vars(self).items()}
        return StartState(**fields)

    def __getitem__(self, rows: Tensor | slice) -> StartState:
        """Return the start states of some rows."""
        return self.map(lambda value: value[rows])

    def __len__(self) -> int:
        return self.base_pos.shape[0]

    def state_dict(self) -> dict[str, Tensor]:
        """Return the tensors by name, without the fields that are None."""
        return {name: value for name, value in vars(self).items() if value is not None}

    @classmethod
    def from_state_dict(cls, state: dict[str, Tensor], device: torch.device) -> StartState:
        """Return the start states that `state_dict` gave.

        Args:
            state: Tensors by name.
            device: Device of the start states.
        """
        return cls(**{name: values.to(device) for name, values in state.items()})

    @staticmethod
    def cat(parts: list[StartState]) -> StartState:
        """Concatenate batches of start states."""
        fields: dict[str, Any] = {name: _merge(parts, name, torch.cat) for name in vars(parts[0])}
        return StartState(**fields)

    @staticmethod
    def where(mask: Tensor, first: StartState, second: StartState) -> StartState:
        """Select rows from two batches.

        Args:
            mask: ``[N]`` bool.
            first: ``[N]`` start states, taken where the mask is true.
            second: ``[N]`` start states, taken where it is false.
        """

        def select(pair: list[Tensor]) -> Tensor:
            return where_rows(mask, *pair)

        fields: dict[str, Any] = {name: _merge([first, second], name, select) for name in vars(first)}
        return StartState(**fields)


_BOARD = {
    "board_xy": (2,),
    "board_lift": (),
    "board_yaw": (),
    "board_yaw_rate": (),
    "board_lean": (),
    "truck_angle": (2,),
}
"""Shapes per world of the fields that may be None."""


def _merge(parts: list[StartState], name: str, merge: Callable[[list[Tensor]], Tensor]) -> Tensor | None:
    """Merge a field of several batches; None if all have None, which stands for zeros."""
    values = [getattr(part, name) for part in parts]
    if all(value is None for value in values):
        return None
    if name == "world" and any(value is None for value in values):
        raise ValueError("start states of worlds with boards of their own cannot be mixed with others")
    filled = [p.board_speed.new_zeros(len(p), *_BOARD[name]) if v is None else v for p, v in zip(parts, values)]
    return merge(filled)


def where_rows(mask: Tensor, first: Tensor, second: Tensor) -> Tensor:
    """Select rows from two tensors.

    Args:
        mask: ``[N]`` bool.
        first: ``[N, ...]``, or a shape that broadcasts to it, taken where the mask is true.
        second: ``[N, ...]``, taken where it is false.

    Returns:
        ``[N, ...]``.
    """
    return torch.where(mask.view(-1, *[1] * (second.dim() - 1)), first, second)


class VisualModels:
    """The models with everything that is only drawn, compiled when they are needed.

    Args:
        scene: The scene.
    """

    def __init__(self, scene: Scene):
        self._scene = scene
        self._last: tuple[SkateboardConfig, mujoco.MjModel] | None = None

    def model(self, i: int, boards: Boards | None) -> mujoco.MjModel:
        """Return the model of a world.

        Args:
            i: Index of the world.
            boards: The boards of the worlds; None if all have that of the scene.
        """
        board = self._scene.board.config if boards is None else boards.of_world[i]
        if self._last is None or self._last[0] is not board:
            scene = self._scene if boards is None else self._scene.with_board(board)
            self._last = board, scene.compile()
        return self._last[1]


def posed_data(
    model: mujoco.MjModel, qpos: np.ndarray, qvel: np.ndarray, mocap_pos: np.ndarray
) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Compute a model's pose for rendering.

    Args:
        model: The compiled scene with visuals.
        qpos: ``[nq]`` positions.
        qvel: ``[nv]`` velocities.
        mocap_pos: ``[nmocap, 3]`` positions of the mocap bodies, m.

    Returns:
        The model, and new data in that pose.
    """
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.mocap_pos[:] = qpos, qvel, mocap_pos
    mujoco.mj_forward(model, data)
    return model, data
