"""The contract between the environment and an engine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import mujoco
import numpy as np
import torch
from torch import Tensor

from skatemount.envs.scene import SceneIndex
from skatemount.envs.state import SimState


class Physics(Protocol):
    """N worlds of one scene.

    Tensors are float32 unless said otherwise, and of the whole batch, but for what begins anew in some worlds.
    """

    num_worlds: int
    device: torch.device
    """Where states are, and tensors that it is given are expected."""
    model: mujoco.MjModel
    """The scene as compiled; never randomised."""
    index: SceneIndex
    description: str
    """What steps the worlds, in a few words."""

    def step(self, targets: Tensor, substeps: int) -> None:
        """Advance every world by ``substeps`` physics steps.

        Args:
            targets: ``[N, 12]`` joint position targets, rad.
            substeps: Physics steps.
        """
        ...

    def reset(self, mask: Tensor, start: StartState) -> None:
        """Put the chosen worlds into start states and compute everything that depends on them.

        Args:
            mask: ``[N]`` bool.
            start: One start for each of them, in order.
        """
        ...

    def push(self, mask: Tensor, velocity: Tensor) -> None:
        """Add to the trunk's velocity in the chosen worlds.

        Args:
            mask: ``[N]`` bool.
            velocity: ``[N, 3]`` world frame, m/s.
        """
        ...

    def state(self, rows: Tensor | None = None) -> SimState:
        """The state of every world; the tensors are the caller's.

        Args:
            rows: ``[K]`` int64, only these worlds.
        """
        ...

    def field(self, name: str) -> Tensor:
        """A model field with a value for each world, ``[N, ...]``; writes take effect at the next step or reset."""
        ...

    def refresh_constants(self) -> None:
        """Recompute what the model derives from masses and inertias after `field` changed them."""
        ...

    def diverged(self) -> Tensor:
        """``[N]`` bool, worlds whose physics failed (not finite or out of bounds) since their last reset."""
        ...

    def render_data(self, i: int) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """One world's pose with everything there is to see, to render it."""
        ...

    def overflowed(self) -> str | None:
        """What went wrong and what to raise if a buffer was too small and contacts were lost since this was last asked.

        None if all is well.
        """
        ...

    def raw_state(self) -> Any:
        """A copy of all that integration goes on from, for `set_raw_state`."""
        ...

    def set_raw_state(self, state: Any) -> None:
        """Put every world back to where it was, and compute everything that depends on it."""
        ...

    def close(self) -> None:
        """Free the engine's memory and threads."""
        ...


@dataclass
class StartState:
    """What an engine needs to start a world.

    Attributes:
        base_pos: ``[N, 3]`` trunk centre, world, m.
        base_quat: ``[N, 4]``.
        base_lin_vel: ``[N, 3]`` world, m/s.
        base_ang_vel: ``[N, 3]`` trunk frame, rad/s.
        joint_pos: ``[N, 12]`` rad.
        joint_vel: ``[N, 12]`` rad/s.
        ground_height: ``[N]`` height of the robot's floor, m.
        board_fixed: ``[N]`` bool.
        board_speed: ``[N]`` speed of the rolling board along its x axis, m/s; 0 where it is fixed.
        force: ``[N, 3]`` constant force on the trunk for the episode, world, N.
        torque: ``[N, 3]`` constant torque on the trunk, world, N m.
        bin: ``[N]`` int64, the part of a curriculum that the start comes from, -1 for none; no engine looks at it.
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

    def __getitem__(self, rows: Tensor | slice) -> StartState:
        """The starts of some rows."""
        return StartState(**{name: value[rows] for name, value in vars(self).items()})

    def __len__(self) -> int:
        return self.base_pos.shape[0]

    @staticmethod
    def cat(parts: list[StartState]) -> StartState:
        """Join batches of starts."""
        return StartState(**{name: torch.cat([getattr(p, name) for p in parts]) for name in vars(parts[0])})

    @staticmethod
    def where(mask: Tensor, first: StartState, second: StartState) -> StartState:
        """The first's rows where the ``[N]`` mask is true, the second's elsewhere."""

        def choose(a: Tensor, b: Tensor) -> Tensor:
            return torch.where(mask.view(-1, *[1] * (a.dim() - 1)), a, b)

        return StartState(**{name: choose(value, getattr(second, name)) for name, value in vars(first).items()})


def posed_data(
    model: mujoco.MjModel, qpos: np.ndarray, qvel: np.ndarray, mocap_pos: np.ndarray
) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """A model in a pose, to be rendered.

    Args:
        model: With all that is to be seen.
        qpos: ``[nq]``.
        qvel: ``[nv]``.
        mocap_pos: ``[nmocap, 3]`` m.
    """
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.mocap_pos[:] = qpos, qvel, mocap_pos
    mujoco.mj_forward(model, data)
    return model, data
