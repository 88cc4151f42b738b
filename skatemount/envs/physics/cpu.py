"""`CpuPhysics`: `mujoco.batch.Batch` steps every world in one call, on a pool of threads."""

from __future__ import annotations

import mujoco
import numpy as np
import torch
from mujoco.batch import Batch
from torch import Tensor

from skatemount.envs.boards import Boards
from skatemount.envs.physics import target_history
from skatemount.envs.physics.base import StartState, VisualModels, posed_data
from skatemount.envs.physics.board_start import BoardStart
from skatemount.envs.scene import Scene, SceneIndex
from skatemount.envs.state import SimState, StateReader
from skatemount.utils.cores import available_cores

_POSITION_AND_VELOCITY = mujoco.mjtStage.mjSTAGE_VEL.value
_EVERYTHING = mujoco.mjtStage.mjSTAGE_ACC.value
# After one of these warnings, MuJoCo resets a world to the model's default state.
_DIVERGED = [
    int(w)
    for w in (
        mujoco.mjtWarning.mjWARN_BADQPOS,
        mujoco.mjtWarning.mjWARN_BADQVEL,
        mujoco.mjtWarning.mjWARN_BADQACC,
    )
]

_STATE = (
    "qpos", "qvel", "ctrl", "qacc_warmstart", "qfrc_applied", "xfrc_applied", "eq_active", "mocap_pos", "mocap_quat",
)  # fmt: skip

_OVERFLOWED = [int(mujoco.mjtWarning.mjWARN_CONTACTFULL), int(mujoco.mjtWarning.mjWARN_CNSTRFULL)]


class CpuPhysics:
    """Worlds stepped by MuJoCo's C engine, with the results of `mj_step` bit for bit at any number of threads.

    Args:
        scene: The scene.
        num_worlds: Number of worlds.
        threads: Number of physics threads; 0 takes every core.
    """

    def __init__(self, scene: Scene, num_worlds: int, threads: int = 0):
        self.num_worlds, self.device = num_worlds, torch.device("cpu")
        self.model = scene.compile(visuals=False)
        self.index = SceneIndex.of(scene, self.model)
        self.threads = threads or available_cores()
        self.description = f"mujoco.batch, {self.threads} threads"
        # Each world keeps its own engine memory, so a step continues from the last one instead of computing positions
        # and velocities of its first substep again.
        self._batch = Batch(self.model, num_worlds, self.threads, persistent=True)
        bind = self._batch.bind
        self._qpos, self._qvel, self._qacc = bind("qpos"), bind("qvel"), bind("qacc")
        self._ctrl, self._wrench = bind("ctrl"), bind("xfrc_applied")
        self._weld, self._mocap = bind("eq_active"), bind("mocap_pos")
        self._sensordata = bind("sensordata")
        # What a state is read from: the engine's arrays, or after `load_state_dict` copies until the next step.
        self._read = (self._sensordata, self._qacc)
        # A slice is copied faster than an index array, and the joints are one if their addresses have no gaps.
        dof = self.index.joint_dof
        self._joint_dof: slice | np.ndarray = dof
        if (np.diff(dof) == 1).all():
            self._joint_dof = slice(int(dof[0]), int(dof[-1]) + 1)
        self._reader = StateReader(self.index)
        self._board_start = BoardStart(scene.board.config)
        self._history = target_history.TargetHistory(self.model, self.index)
        self._boards: Boards | None = None
        self._lost_contacts = False
        self._fields: dict[str, np.ndarray] = {}
        self._default = self._batch.state[0].copy()
        self._visuals = VisualModels(scene)
        self._batch.forward()

    def step(self, targets: Tensor, substeps: int) -> None:
        """Advance every world; see `Physics.step`."""
        self._ctrl[:, self.index.actuators] = targets.numpy()
        self._batch.step(nstep=substeps, stage=_POSITION_AND_VELOCITY)
        self._read = (self._sensordata, self._qacc)

    def reset(self, mask: Tensor, start: StartState) -> None:
        """Put the chosen worlds into start states; see `Physics.reset`."""
        ids = np.flatnonzero(mask.numpy())
        if not ids.size:
            return
        index = self.index
        self._lost_contacts |= bool(self._warned(_OVERFLOWED, ids).any())
        # The same as `Batch.reset`, which would also wipe all of a world's memory.
        self._batch.state[ids], self._batch.warning[ids] = self._default, 0
        qpos = self._qpos[ids]
        qpos[:, index.base_qpos] = torch.cat((start.base_pos, start.base_quat), -1).numpy()
        qpos[:, index.joint_qpos] = start.joint_pos.numpy()
        self._qpos[ids] = qpos
        qvel = start.board_speed.double().unsqueeze(1).numpy() * index.rolling
        qvel[:, index.base_dof] = torch.cat((start.base_lin_vel, start.base_ang_vel), -1).numpy()
        qvel[:, index.joint_dof] = start.joint_vel.numpy()
        if self._boards is not None or not start.usual_board:
            board = self._board_start if self._boards is None else BoardStart(self._boards.sizes[torch.from_numpy(ids)])
            self._qpos[np.ix_(ids, index.board_qpos)] = board.positions(start).numpy()
            qvel[:, index.board_dof] = board.velocities(start).numpy()
        self._qvel[ids] = qvel
        self._ctrl[np.ix_(ids, index.actuators)] = start.joint_pos.numpy()
        if self.model.nhistory:
            self._batch.bind("history")[ids] = self._history.filled(start.joint_pos).numpy()
        self._wrench[ids, index.trunk_body] = torch.cat((start.force, start.torque), -1).numpy()
        self._weld[ids, index.weld] = start.board_fixed.numpy()
        self._mocap[ids, index.floor_mocap, 2] = start.ground_height.numpy()
        # All stages, because force sensors would otherwise keep the values of the last episode.
        self._batch.forward(ids, stage=_EVERYTHING)
        for read, array in zip(self._read, (self._sensordata, self._qacc)):
            if read is not array:
                read[ids] = array[ids]

    def push(self, mask: Tensor, velocity: Tensor, board: bool = False) -> None:
        """Add to the velocity of the trunk or the deck; see `Physics.push`."""
        dof = int(self.index.board_dof[0]) if board else self.index.base_dof.start
        self._qvel[:, dof : dof + 3] += np.where(mask.numpy()[:, None], velocity.numpy(), 0.0)

    def pull_board(self, force: Tensor) -> None:
        """Set the force on the board; see `Physics.pull_board`."""
        self._wrench[:, self.index.board_body, :3] = force.numpy()

    def state(self, rows: Tensor | None = None) -> SimState:
        """Return the state of every world, or of some; see `Physics.state`."""
        which = slice(None) if rows is None else rows.numpy()

        def copy(values: np.ndarray) -> Tensor:
            return torch.from_numpy(values.astype(np.float32))

        sensordata, qacc = self._read
        return self._reader.read(
            copy(sensordata[which]),
            copy(qacc[which][:, self._joint_dof]),
            copy(self._mocap[which, self.index.floor_mocap, 2]),
            torch.from_numpy(self._weld[which, self.index.weld] > 0),
            None if self._boards is None else self._boards.columns[slice(None) if rows is None else rows],
        )

    def field(self, name: str) -> Tensor:
        """Return a live ``[N, ...]`` float64 view of a model field, which then has a value for each world."""
        self._fields[name] = self._batch.expand(name)
        return torch.from_numpy(self._fields[name])

    def set_boards(self, boards: Boards, fields: dict[str, np.ndarray]) -> None:
        """Give every world a board of its own; see `Physics.set_boards`."""
        self._boards = boards
        for name, values in fields.items():
            self.field(name)[:] = torch.from_numpy(values)

    def refresh_constants(self) -> None:
        """Recompute the model constants that depend on masses and inertias."""
        self._batch.set_const()

    def diverged(self) -> Tensor:
        """Return ``[N]`` bool: worlds whose physics failed since their last reset."""
        return torch.from_numpy(self._warned(_DIVERGED) | ~np.isfinite(self._qpos).all(-1))

    def overflowed(self) -> str | None:
        """Return an error message if contacts or constraints were dropped, else None; see `Physics.overflowed`."""
        if self._lost_contacts or self._warned(_OVERFLOWED).any():
            self._lost_contacts = False
            self._batch.warning[:, _OVERFLOWED, 1] = 0
            return f"MuJoCo dropped contacts: its memory of {self.model.narena} bytes for a world is too small"
        return None

    def raw_state(self) -> np.ndarray:
        """Return a copy of every world's full integration state, ``[N, S]`` float64; see `set_raw_state`."""
        return self._batch.state.copy()

    def set_raw_state(self, state: np.ndarray) -> None:
        """Restore a state from `raw_state` and compute everything that depends on it."""
        self._batch.state[:] = state
        self._batch.forward()

    def world(self, i: int, state: np.ndarray) -> tuple[mujoco.MjModel, dict[str, np.ndarray]]:
        """Return a copy of a world's model, and its part of a state; see `Physics.world`."""
        data = mujoco.MjData(self.model)
        mujoco.mj_setState(self.model, data, state[i], mujoco.mjtState.mjSTATE_INTEGRATION)
        names = (*_STATE, *target_history.state(self.model))
        return self._batch.get_model(i), {name: np.array(getattr(data, name)) for name in names}

    def state_dict(self) -> dict[str, Tensor]:
        """Return copies of all that a step or a reset depends on; see `Physics.state_dict`."""
        sensordata, qacc = self._read
        arrays = {"state": self._batch.state, "warning": self._batch.warning, "sensordata": sensordata, "qacc": qacc}
        fields = {f"field.{name}": values for name, values in self._fields.items()}
        return {name: torch.tensor(values) for name, values in (arrays | fields).items()}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restore what `state_dict` returned; see `Physics.load_state_dict`."""
        for name, values in state.items():
            if name.startswith("field."):
                self._batch.expand(name.removeprefix("field."))[:] = values.numpy()
        self._batch.state[:] = state["state"].numpy()
        # A step continues from these stages. The warnings, forces and accelerations are those of the last step.
        self._batch.forward(stage=_POSITION_AND_VELOCITY)
        self._batch.warning[:] = state["warning"].numpy()
        self._read = (state["sensordata"].numpy().copy(), state["qacc"].numpy().copy())

    def render_data(self, i: int) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """Return a model with visuals, and data with one world's pose; see `Physics.render_data`."""
        return posed_data(self._visuals.model(i, self._boards), self._qpos[i], self._qvel[i], self._mocap[i])

    def poses(self, worlds: slice) -> tuple[np.ndarray, np.ndarray]:
        """Return copies of the positions of some worlds; see `Physics.poses`."""
        return self._qpos[worlds].copy(), self._mocap[worlds].copy()

    def close(self) -> None:
        """Stop the threads and free the worlds; a second call does nothing."""
        # Every view of the worlds keeps the batch and its threads.
        for name, value in list(vars(self).items()):
            if isinstance(value, np.ndarray | Batch | mujoco.MjModel | dict | tuple):
                delattr(self, name)

    def _warned(self, kinds: list[int], worlds: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Find worlds that had a warning since their last reset.

        Args:
            kinds: Ids of the warnings.
            worlds: ``[K]`` worlds; all by default.

        Returns:
            ``[K]`` bool.
        """
        # Each warning is a pair of its latest detail and the number of times that it was raised.
        return (self._batch.warning[worlds][:, kinds, 1] > 0).any(-1)
