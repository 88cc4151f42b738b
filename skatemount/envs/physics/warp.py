"""`WarpPhysics`: mujoco_warp steps every world on one GPU, or on Warp's CPU device for tests."""

from __future__ import annotations

import copy
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp
from torch import Tensor

from skatemount.envs.boards import Boards
from skatemount.envs.physics import target_history, warp_fields
from skatemount.envs.physics.base import StartState, VisualModels, posed_data, where_rows
from skatemount.envs.physics.board_start import BoardStart
from skatemount.envs.scene import Scene, SceneIndex
from skatemount.envs.state import SimState, StateReader
from skatemount.utils.devices import choose_device

STATE = ("qpos", "qvel", "qacc_warmstart", "ctrl", "xfrc_applied", "eq_active", "mocap_pos")
"""Data fields that the next step depends on."""
RESULTS = ("sensordata", "qacc")
"""Data fields that a step or reset computes and `SimState` is read from."""

_TOO_SMALL = {
    # Contacts come first, because the number of constraints means nothing once contacts are lost.
    mjw.OverflowType.BROADPHASE: "max_contacts",
    mjw.OverflowType.NARROWPHASE: "max_contacts",
    mjw.OverflowType.CCD: "max_contacts",
    mjw.OverflowType.CONTACT_MATCH: "max_contacts",
    mjw.OverflowType.NEFC: "max_constraints",
    mjw.OverflowType.NJMAX_NNZ: "max_constraints",
}
_NO_SENSORS = int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
_FORWARD = 0
_FEW = 8
"""A reset of at most 1/8 of the worlds, as nearly all are, is computed in a small batch of its own."""
_SPARE_WORLDS = 8
"""The small batch has memory for the contacts of 8 more worlds, because an average over few worlds varies widely."""
_SENSOR_SHARE = 3
"""A contact sensor adds up at most 1/3 of `max_contacts`."""
_LARGEST = 1e10
"""Absolute value beyond which MuJoCo resets a world (mjMAXVAL)."""


class _Worlds:
    """A batch of worlds in Warp's memory, torch's views of it, and the CUDA graphs that step it.

    Args:
        model: The compiled scene.
        num_worlds: Number of worlds.
        device: Device of the worlds.
        contacts: Memory for contacts, per world on average.
        constraints: Memory for constraint rows, per world.
        spare: Number of additional worlds whose contacts there is memory for.
        boards_vary: True if the worlds' boards differ.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        num_worlds: int,
        device: torch.device,
        contacts: int,
        constraints: int,
        spare: int = 0,
        boards_vary: bool = False,
    ):
        self.num_worlds = num_worlds
        self._device, self._warp_device = device, wp.device_from_torch(device)
        with wp.ScopedDevice(self._warp_device):
            fields = warp_fields.of_each_world(model, boards_vary)
            self.model = mjw.put_model(model, dict.fromkeys(fields, num_worlds))
            # `overflowed` reports an overflow. Warp would print a line per world and step.
            self.model.opt.warn_overflow = 0
            # For each contact sensor of each world, mujoco_warp launches a block that sorts contacts, even where forces
            # are only added up, as here. Blocks of one warp with few contacts to sort keep this cheap.
            self.model.opt.contact_sensor_maxmatch = max(1, contacts // _SENSOR_SHARE)
            self.model.block_dim.contact_sort = 32
            self.data = mjw.make_data(model, num_worlds, naconmax=contacts * (num_worlds + spare), njmax=constraints)
        self.fields = {name: wp.to_torch(getattr(self.model, name)) for name in fields}
        state = (*STATE, *target_history.state(model))
        self.state = {name: wp.to_torch(getattr(self.data, name)) for name in state}
        self.results = {name: wp.to_torch(getattr(self.data, name)) for name in RESULTS}
        self.overflow = wp.to_torch(self.data.overflow)
        self._found = [wp.to_torch(each) for each in (self.data.nacon, self.data.ncollision)]
        self._graphs: dict[int, wp.Graph] = {}
        self.launch(_FORWARD)

    def lost_contacts(self) -> Tensor:
        """Return a bool scalar: whether the last collision detection found more contacts than there is memory for.

        `overflow` is set by steps only, and so says nothing about a reset.
        """
        return torch.cat(self._found).max() > self.data.naconmax

    def launch(self, substeps: int) -> None:
        """Run `_work`, on a GPU as a CUDA graph that the first call captures."""
        if substeps in self._graphs:
            wp.capture_launch(self._graphs[substeps], self._stream())
            return
        self.run(lambda: self._work(substeps))
        if self._device.type == "cuda":
            torch.cuda.synchronize(self._device)
            with wp.ScopedDevice(self._warp_device), wp.ScopedCapture() as capture:
                self._work(substeps)
            self._graphs[substeps] = capture.graph

    def run(self, work: Callable[[], Any]) -> None:
        """Run Warp's kernels on torch's stream, so that they keep their order with torch's."""
        if self._device.type == "cpu":
            with wp.ScopedDevice(self._warp_device):
                work()
            return
        with wp.ScopedStream(self._stream()):
            work()

    def _stream(self) -> wp.Stream:
        return wp.stream_from_torch(torch.cuda.current_stream(self._device))

    def _work(self, substeps: int) -> None:
        """Step the worlds, then compute positions and velocities of the new state.

        Args:
            substeps: Number of physics steps; 0 to compute the present state completely.
        """
        model, data = self.model, self.data
        if not substeps:
            mjw.forward(model, data)
            return
        flags = model.opt.disableflags
        # Sensors are read after the last step only.
        model.opt.disableflags |= _NO_SENSORS
        try:
            for _ in range(substeps - 1):
                mjw.step(model, data)
        finally:
            model.opt.disableflags = flags
        mjw.step(model, data)
        # Forces remain those of the last step. The next step detects contacts again.
        mjw.fwd_kinematics(model, data)
        mjw.sensor_pos(model, data)
        mjw.fwd_velocity(model, data)
        mjw.sensor_vel(model, data)


class WarpPhysics:
    """Worlds stepped by mujoco_warp, in single precision.

    Torch and Warp share the memory of the state. On a GPU, the substeps of a control step are one CUDA graph, and only
    the indices of reset worlds are copied to the host.

    Args:
        scene: The scene.
        num_worlds: Number of worlds.
        device: Device of the worlds: ``auto`` (a GPU if there is one, else the CPU), ``cuda``, ``cuda:1`` or ``cpu``.
        max_contacts: Memory for contacts, per world on average. A contact sensor adds up at most a third as many.
        max_constraints: Memory for constraint rows, per world.

    Raises:
        ConfigError: The device does not exist.
    """

    def __init__(
        self, scene: Scene, num_worlds: int, device: str = "auto", max_contacts: int = 48, max_constraints: int = 160
    ):
        self.num_worlds, self.device = num_worlds, choose_device(device)
        self.model = scene.compile(visuals=False)
        self.index = SceneIndex.of(scene, self.model)
        self.max_contacts, self.max_constraints = max_contacts, max_constraints
        self._visuals = VisualModels(scene)
        wp.init()
        _announce_compilation()
        self.description = f"mujoco_warp on {wp.device_from_torch(self.device).name}"
        vary, few = scene.boards_vary, max(1, num_worlds // _FEW)
        self._all = _Worlds(self.model, num_worlds, self.device, max_contacts, max_constraints, boards_vary=vary)
        self._few = _Worlds(self.model, few, self.device, max_contacts, max_constraints, _SPARE_WORLDS, vary)
        self._state = self._all.state
        with self.device:
            self._failed = torch.zeros(num_worlds, dtype=torch.bool)
            self._lost_in_reset = torch.zeros((), dtype=torch.bool)
            self._qpos0 = torch.as_tensor(self.model.qpos0, dtype=torch.float32)
            self._rolling = torch.as_tensor(self.index.rolling, dtype=torch.float32)
            self._joint_qpos, self._joint_dof, self._actuators = (
                torch.as_tensor(ids) for ids in (self.index.joint_qpos, self.index.joint_dof, self.index.actuators)
            )
            self._board_qpos, self._board_dof = map(torch.as_tensor, (self.index.board_qpos, self.index.board_dof))
        self._board_start = BoardStart(scene.board.config, self.device)
        self._history = target_history.TargetHistory(self.model, self.index, self.device)
        self._boards: Boards | None = None
        self._reader = StateReader(self.index)

    def step(self, targets: Tensor, substeps: int) -> None:
        """Advance every world; see `Physics.step`."""
        self._state["ctrl"][:, self._actuators] = targets
        self._all.launch(substeps)
        self._reset_diverged()

    def _reset_diverged(self) -> None:
        """Put diverged worlds back to the model's default state, as MuJoCo's C engine does."""
        qpos, qvel = self._state["qpos"], self._state["qvel"]
        # A comparison with nan is false, so this finds nan as well.
        failed = ~((qpos.abs() < _LARGEST).all(-1) & (qvel.abs() < _LARGEST).all(-1))
        self._failed |= failed
        qpos.copy_(where_rows(failed, self._qpos0, qpos))
        for name in ("qvel", "qacc_warmstart", "ctrl"):
            self._state[name].masked_fill_(failed.unsqueeze(1), 0.0)
        for values in self._all.results.values():
            torch.nan_to_num_(values, 0.0, 0.0, 0.0)

    def reset(self, mask: Tensor, start: StartState) -> None:
        """Put the chosen worlds into start states; see `Physics.reset`."""
        index, rows = self.index, mask.nonzero().squeeze(1)
        qpos = self._qpos0.repeat(len(rows), 1) if self._boards is None else self._qpos0[rows]
        qpos[:, index.base_qpos] = torch.cat((start.base_pos, start.base_quat), -1)
        qpos[:, self._joint_qpos] = start.joint_pos
        qvel = start.board_speed.unsqueeze(1) * self._rolling
        qvel[:, index.base_dof] = torch.cat((start.base_lin_vel, start.base_ang_vel), -1)
        qvel[:, self._joint_dof] = start.joint_vel
        if self._boards is not None or not start.usual_board:
            own = self._board_start if self._boards is None else BoardStart(self._boards.sizes[rows], self.device)
            qpos[:, self._board_qpos] = own.positions(start).float()
            qvel[:, self._board_dof] = own.velocities(start).float()
        fresh = {name: value.new_zeros(len(rows), *value.shape[1:]) for name, value in self._state.items()}
        fresh |= {"qpos": qpos, "qvel": qvel}
        fresh["ctrl"][:, self._actuators] = start.joint_pos
        if "history" in fresh:
            fresh["history"] = self._history.filled(start.joint_pos).float()
        fresh["xfrc_applied"][:, index.trunk_body] = torch.cat((start.force, start.torque), -1)
        fresh["eq_active"][:, index.weld] = start.board_fixed
        fresh["mocap_pos"] = self._state["mocap_pos"][rows]
        fresh["mocap_pos"][:, index.floor_mocap, 2] = start.ground_height
        for name, value in self._state.items():
            value[rows] = fresh[name]
        self._failed &= ~mask
        if len(rows) > self._few.num_worlds:
            self._forward_all(mask)
        elif len(rows):
            self._forward_few(rows, fresh)

    def _forward_all(self, mask: Tensor) -> None:
        """Compute the chosen worlds as part of all. The others keep the results of their last step, such as forces."""
        before = {name: values.clone() for name, values in self._all.results.items()}
        self._all.launch(_FORWARD)
        for name, values in self._all.results.items():
            values.copy_(where_rows(mask, values, before[name]))

    def _forward_few(self, rows: Tensor, fresh: dict[str, Tensor]) -> None:
        """Compute the chosen worlds in the small batch.

        Args:
            rows: ``[K]`` int64, the chosen worlds.
            fresh: Their start states: ``[K, ...]`` by name of the data field.
        """
        every, few, n = self._all, self._few, len(rows)
        for name, values in few.fields.items():
            values[:n] = every.fields[name][rows]
        for name, values in few.state.items():
            values[:n] = fresh[name]
        few.launch(_FORWARD)
        self._lost_in_reset |= few.lost_contacts()
        for name, values in every.results.items():
            values[rows] = few.results[name][:n]

    def push(self, mask: Tensor, velocity: Tensor, board: bool = False) -> None:
        """Add to the velocity of the trunk or the deck; see `Physics.push`."""
        dof = int(self.index.board_dof[0]) if board else self.index.base_dof.start
        self._state["qvel"][:, dof : dof + 3] += torch.where(mask.unsqueeze(1), velocity, 0.0)

    def pull_board(self, force: Tensor) -> None:
        """Set the force on the board; see `Physics.pull_board`."""
        self._state["xfrc_applied"][:, self.index.board_body, :3] = force

    def state(self, rows: Tensor | None = None) -> SimState:
        """Return the state of every world, or of some; see `Physics.state`."""

        def copy(values: Tensor) -> Tensor:
            return values.clone() if rows is None else values[rows]

        state, index = self._state, self.index
        return self._reader.read(
            copy(self._all.results["sensordata"]),
            copy(self._all.results["qacc"])[:, self._joint_dof],
            copy(state["mocap_pos"][:, index.floor_mocap, 2]),
            copy(state["eq_active"][:, index.weld]),
            None if self._boards is None else copy(self._boards.columns),
        )

    def field(self, name: str) -> Tensor:
        """Return a live ``[N, ...]`` float32 view of a model field that has a value for each world.

        Raises:
            KeyError: The field is the same in every world.
        """
        if name not in (known := warp_fields.settable(self.model)):
            raise KeyError(f"{name} is not among the fields that differ from world to world: {', '.join(known)}")
        return self._all.fields[name]

    def set_boards(self, boards: Boards, fields: dict[str, np.ndarray]) -> None:
        """Give every world a board of its own; see `Physics.set_boards`."""
        self._boards = boards
        for name in warp_fields.OF_BOARDS:
            warp_fields.write(self._all.fields[name], fields[name])
        self._qpos0 = self._all.fields["qpos0"]

    def refresh_constants(self) -> None:
        """Recompute the model constants that depend on masses and inertias."""
        before = self._state["qpos"].clone()
        self._all.run(lambda: mjw.set_const(self._all.model, self._all.data))
        self._state["qpos"].copy_(before)

    def diverged(self) -> Tensor:
        """Return ``[N]`` bool: worlds whose physics failed since their last reset."""
        return self._failed.clone()

    def overflowed(self) -> str | None:
        """Return a message if contacts or constraints were dropped since the last call; see `Physics.overflowed`."""
        overflow = self._all.overflow.to("cpu", copy=True)
        self._all.overflow.zero_()
        for bit, setting in _TOO_SMALL.items():
            if lost := int(((overflow & int(bit)) != 0).sum()):
                return (
                    f"mujoco_warp dropped {setting.removeprefix('max_')} in {lost} of {self.num_worlds} worlds "
                    f"({bit.name}); physics.{setting}={getattr(self, setting)} must be larger"
                )
        if self._lost_in_reset:
            self._lost_in_reset.zero_()
            return f"mujoco_warp dropped contacts in a reset; physics.max_contacts={self.max_contacts} must be larger"
        return None

    def raw_state(self) -> dict[str, Tensor]:
        """Return a copy of every world's full integration state; see `set_raw_state`."""
        return {name: value.clone() for name, value in self._state.items()}

    def set_raw_state(self, state: dict[str, Tensor]) -> None:
        """Restore a state from `raw_state` and compute everything that depends on it."""
        for name, value in state.items():
            self._state[name].copy_(value)
        self._all.launch(_FORWARD)

    def world(self, i: int, state: dict[str, Tensor]) -> tuple[mujoco.MjModel, dict[str, np.ndarray]]:
        """Return a copy of a world's model, and its part of a state; see `Physics.world`."""
        model = copy.copy(self.model)
        for name, values in self._all.fields.items():
            own = getattr(model, name)
            # Single precision would make every field differ.
            row = warp_fields.read(values, i, own)
            own[...] = np.where(row == own.astype(row.dtype), own, row)
        return model, {name: values[i].cpu().numpy().copy() for name, values in state.items()}

    def state_dict(self) -> dict[str, Tensor]:
        """Return copies of all that a step or a reset depends on; see `Physics.state_dict`."""
        return {name: values.clone() for name, values in self._saved_tensors().items()}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restore what `state_dict` returned; see `Physics.load_state_dict`."""
        for name, values in self._saved_tensors().items():
            # A run of an older version had fewer fields for each world. The others keep the model's values.
            values.copy_(state.get(name, values) if name.startswith("field.") else state[name])

    def _saved_tensors(self) -> dict[str, Tensor]:
        every = self._all
        kinds = {"state": every.state, "field": every.fields, "result": every.results}
        named = {f"{kind}.{name}": values for kind, tensors in kinds.items() for name, values in tensors.items()}
        return named | {"failed": self._failed}

    def render_data(self, i: int) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """Return a model with visuals, and data with one world's pose; see `Physics.render_data`."""
        qpos, qvel, mocap = (self._state[name][i].cpu().numpy() for name in ("qpos", "qvel", "mocap_pos"))
        return posed_data(self._visuals.model(i, self._boards), qpos, qvel, mocap)

    def poses(self, worlds: slice) -> tuple[np.ndarray, np.ndarray]:
        """Return copies of the positions of some worlds; see `Physics.poses`."""
        # Copies also on a CPU, and in the precision of the other engine.
        qpos, mocap_pos = (self._state[name][worlds].double().cpu().numpy() for name in ("qpos", "mocap_pos"))
        return qpos, mocap_pos

    def close(self) -> None:
        """Free the worlds; a second call does nothing."""
        for name in ("_all", "_few", "_state"):
            vars(self).pop(name, None)


def _announce_compilation() -> None:
    cache = wp.config.kernel_cache_dir
    if cache is not None and not any(Path(cache).glob("*mujoco_warp*")):
        news = "mujoco_warp compiles its kernels; this takes a minute or two, once per machine"
        print(news, file=sys.stderr, flush=True)
