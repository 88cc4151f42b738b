"""`WarpPhysics`: mujoco_warp, every world of the batch on one GPU, or on Warp's CPU device to try it."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import mujoco_warp as mjw
import torch
import warp as wp
from torch import Tensor

from skatemount.envs.physics.base import StartState, posed_data
from skatemount.envs.scene import Scene, SceneIndex
from skatemount.envs.state import SimState, StateReader
from skatemount.utils.devices import choose_device

RANDOMISED = ("geom_friction", "jnt_stiffness", "body_mass", "body_inertia", "body_ipos", "actuator_gainprm")
"""Model fields with a value for each world."""
DERIVED = ("body_subtreemass", "body_invweight0", "dof_invweight0", "actuator_acc0")
"""What follows from masses and inertias, and differs from world to world with them."""
STATE = ("qpos", "qvel", "qacc_warmstart", "ctrl", "xfrc_applied", "eq_active", "mocap_pos")
"""What integration goes on from."""
RESULTS = ("sensordata", "qacc")
"""What the last step, or a reset, computed from it, and states are read from."""

_TOO_SMALL = {
    # Contacts first: without some of them, counts of constraints mean nothing.
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
"""Resets of up to one in so many worlds are computed by themselves; nearly all are of fewer."""
_SPARE_WORLDS = 8
"""Of a few worlds' contacts, the average is far from the most; there they have memory for so many worlds more."""
_SENSOR_SHARE = 3
"""A contact sensor adds up so many times fewer contacts than `max_contacts`."""
_LARGEST = 1e10
"""Beyond it MuJoCo gives a state up (mjMAXVAL)."""


class _Worlds:
    """So many worlds in Warp's memory, torch's views of them, and the CUDA graphs that step them.

    Args:
        model: The scene.
        num_worlds: Number of worlds.
        device: Where they are.
        contacts: Contacts of a world that there is memory for, on average.
        constraints: Constraint rows of a world that there is memory for.
        spare: Memory for the contacts of so many worlds more.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        num_worlds: int,
        device: torch.device,
        contacts: int,
        constraints: int,
        spare: int = 0,
    ):
        self.num_worlds = num_worlds
        self._device, self._warp_device = device, wp.device_from_torch(device)
        with wp.ScopedDevice(self._warp_device):
            self.model = mjw.put_model(model, dict.fromkeys((*RANDOMISED, *DERIVED), num_worlds))
            # An overflow is found by `overflowed`; Warp would print a line a world and step.
            self.model.opt.warn_overflow = 0
            # Mujoco_warp launches a block that sorts contacts for each contact sensor of each world, also where forces
            # are only added up, as here: the blocks are one warp, and what they would sort is small.
            self.model.opt.contact_sensor_maxmatch = max(1, contacts // _SENSOR_SHARE)
            self.model.block_dim.contact_sort = 32
            self.data = mjw.make_data(model, num_worlds, naconmax=contacts * (num_worlds + spare), njmax=constraints)
        self.fields = {name: wp.to_torch(getattr(self.model, name)) for name in (*RANDOMISED, *DERIVED)}
        self.state = {name: wp.to_torch(getattr(self.data, name)) for name in STATE}
        self.results = {name: wp.to_torch(getattr(self.data, name)) for name in RESULTS}
        self.overflow = wp.to_torch(self.data.overflow)
        self._found = [wp.to_torch(each) for each in (self.data.nacon, self.data.ncollision)]
        self._graphs: dict[int, wp.Graph] = {}
        self.launch(_FORWARD)

    def lost_contacts(self) -> Tensor:
        """Bool, whether there was no memory for all contacts that were just found: `overflow` tells only of steps."""
        return torch.cat(self._found).max() > self.data.naconmax

    def launch(self, substeps: int) -> None:
        """Do `_work`, on a GPU as a graph that is captured after the first time."""
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
        """Run Warp's kernels in order with torch's."""
        if self._device.type == "cpu":
            with wp.ScopedDevice(self._warp_device):
                work()
            return
        with wp.ScopedStream(self._stream()):
            work()

    def _stream(self) -> wp.Stream:
        return wp.stream_from_torch(torch.cuda.current_stream(self._device))

    def _work(self, substeps: int) -> None:
        """Physics steps, and then positions and velocities of what they led to; without steps, everything anew."""
        model, data = self.model, self.data
        if not substeps:
            mjw.forward(model, data)
            return
        flags = model.opt.disableflags
        # Sensors are read after the last step alone.
        model.opt.disableflags |= _NO_SENSORS
        try:
            for _ in range(substeps - 1):
                mjw.step(model, data)
        finally:
            model.opt.disableflags = flags
        mjw.step(model, data)
        # Forces stay those of the last step; contacts are found anew by the next.
        mjw.fwd_kinematics(model, data)
        mjw.sensor_pos(model, data)
        mjw.fwd_velocity(model, data)
        mjw.sensor_vel(model, data)


class WarpPhysics:
    """Worlds stepped by mujoco_warp, in single precision.

    The tensors of its state share Warp's memory. On a GPU the substeps are one CUDA graph, and no more is copied to
    the host than which worlds are reset.

    Args:
        scene: The scene.
        num_worlds: Number of worlds.
        device: Where they are: ``auto`` (a GPU if there is one), ``cuda``, ``cuda:1``, ``cpu``.
        max_contacts: Contacts of a world that there is memory for, on average over the worlds; a contact sensor adds
            up a third as many.
        max_constraints: Constraint rows of a world that there is memory for.

    Raises:
        ConfigError: There is no such device.
    """

    def __init__(
        self, scene: Scene, num_worlds: int, device: str = "auto", max_contacts: int = 48, max_constraints: int = 160
    ):
        self.num_worlds, self.device = num_worlds, choose_device(device)
        self.model = scene.compile(visuals=False)
        self.index = SceneIndex.of(scene, self.model)
        self.max_contacts, self.max_constraints = max_contacts, max_constraints
        self._scene = scene
        wp.init()
        _say_if_it_has_to_compile()
        self.description = f"mujoco_warp on {wp.device_from_torch(self.device).name}"
        self._all = _Worlds(self.model, num_worlds, self.device, max_contacts, max_constraints)
        few = max(1, num_worlds // _FEW)
        self._few = _Worlds(self.model, few, self.device, max_contacts, max_constraints, _SPARE_WORLDS)
        self._state = self._all.state
        with self.device:
            self._failed = torch.zeros(num_worlds, dtype=torch.bool)
            self._lost_in_reset = torch.zeros((), dtype=torch.bool)
            self._qpos0 = torch.as_tensor(self.model.qpos0, dtype=torch.float32)
            self._rolling = torch.as_tensor(self.index.rolling, dtype=torch.float32)
            self._joint_qpos, self._joint_dof, self._actuators = (
                torch.as_tensor(ids) for ids in (self.index.joint_qpos, self.index.joint_dof, self.index.actuators)
            )
        self._reader = StateReader(self.index, self.device)

    def step(self, targets: Tensor, substeps: int) -> None:
        """Advance every world; see `Physics.step`."""
        self._state["ctrl"][:, self._actuators] = targets
        self._all.launch(substeps)
        self._give_up_what_failed()

    def _give_up_what_failed(self) -> None:
        """Put worlds that are not finite any more back to the model's default state, as MuJoCo's C engine does."""
        qpos, qvel = self._state["qpos"], self._state["qvel"]
        # A comparison with nan is false.
        failed = ~((qpos.abs() < _LARGEST).all(-1) & (qvel.abs() < _LARGEST).all(-1))
        self._failed |= failed
        qpos.copy_(_choose(failed, self._qpos0, qpos))
        for name in ("qvel", "qacc_warmstart", "ctrl"):
            self._state[name].masked_fill_(failed.unsqueeze(1), 0.0)
        for values in self._all.results.values():
            torch.nan_to_num_(values, 0.0, 0.0, 0.0)

    def reset(self, mask: Tensor, start: StartState) -> None:
        """Put the chosen worlds into start states; see `Physics.reset`."""
        index, rows = self.index, mask.nonzero().squeeze(1)
        qpos = self._qpos0.repeat(len(rows), 1)
        qpos[:, index.base_qpos] = torch.cat((start.base_pos, start.base_quat), -1)
        qpos[:, self._joint_qpos] = start.joint_pos
        qvel = start.board_speed.unsqueeze(1) * self._rolling
        qvel[:, index.base_dof] = torch.cat((start.base_lin_vel, start.base_ang_vel), -1)
        qvel[:, self._joint_dof] = start.joint_vel
        fresh = {name: value.new_zeros(len(rows), *value.shape[1:]) for name, value in self._state.items()}
        fresh |= {"qpos": qpos, "qvel": qvel}
        fresh["ctrl"][:, self._actuators] = start.joint_pos
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
        """Compute all worlds anew; those that are not chosen keep what their last step left, forces above all."""
        left = {name: values.clone() for name, values in self._all.results.items()}
        self._all.launch(_FORWARD)
        for name, values in self._all.results.items():
            values.copy_(_choose(mask, values, left[name]))

    def _forward_few(self, rows: Tensor, fresh: dict[str, Tensor]) -> None:
        """Compute the chosen worlds, whose states are given, in memory of their own."""
        every, few, n = self._all, self._few, len(rows)
        for name, values in few.fields.items():
            values[:n] = every.fields[name][rows]
        for name, values in few.state.items():
            values[:n] = fresh[name]
        few.launch(_FORWARD)
        self._lost_in_reset |= few.lost_contacts()
        for name, values in every.results.items():
            values[rows] = few.results[name][:n]

    def push(self, mask: Tensor, velocity: Tensor) -> None:
        """Add to the trunk's velocity; see `Physics.push`."""
        dof = self.index.base_dof.start
        self._state["qvel"][:, dof : dof + 3] += torch.where(mask.unsqueeze(1), velocity, 0.0)

    def state(self, rows: Tensor | None = None) -> SimState:
        """The state of every world, or of some, in memory of its own; see `Physics.state`."""

        def copy(values: Tensor) -> Tensor:
            return values.clone() if rows is None else values[rows]

        state, index = self._state, self.index
        return self._reader.read(
            copy(self._all.results["sensordata"]),
            copy(self._all.results["qacc"])[:, self._joint_dof],
            copy(state["mocap_pos"][:, index.floor_mocap, 2]),
            copy(state["eq_active"][:, index.weld]),
        )

    def field(self, name: str) -> Tensor:
        """A live ``[N, ...]`` float32 view of a model field with a value for each world.

        Raises:
            KeyError: The field is the same in every world.
        """
        if name not in RANDOMISED:
            raise KeyError(f"{name} is not among the fields that differ from world to world: {', '.join(RANDOMISED)}")
        return self._all.fields[name]

    def refresh_constants(self) -> None:
        """Recompute what the model derives from masses and inertias."""
        before = self._state["qpos"].clone()
        self._all.run(lambda: mjw.set_const(self._all.model, self._all.data))
        self._state["qpos"].copy_(before)

    def diverged(self) -> Tensor:
        """``[N]`` bool, worlds that had to be given up since their last reset."""
        return self._failed.clone()

    def overflowed(self) -> str | None:
        """What to raise if contacts or constraints were dropped for want of memory, since it was last asked."""
        seen = self._all.overflow.to("cpu", copy=True)
        self._all.overflow.zero_()
        for bit, setting in _TOO_SMALL.items():
            if lost := int(((seen & int(bit)) != 0).sum()):
                return (
                    f"mujoco_warp dropped {setting.removeprefix('max_')} in {lost} of {self.num_worlds} worlds "
                    f"({bit.name}): raise physics.{setting}, which is {getattr(self, setting)}"
                )
        if self._lost_in_reset:
            self._lost_in_reset.zero_()
            return f"mujoco_warp dropped contacts in a reset: raise physics.max_contacts, which is {self.max_contacts}"
        return None

    def raw_state(self) -> dict[str, Tensor]:
        """A copy of every world's full integration state; see `set_raw_state`."""
        return {name: value.clone() for name, value in self._state.items()}

    def set_raw_state(self, state: dict[str, Tensor]) -> None:
        """Restore what `raw_state` returned and compute everything that depends on it."""
        for name, value in state.items():
            self._state[name].copy_(value)
        self._all.launch(_FORWARD)

    @functools.cached_property
    def _visible(self) -> mujoco.MjModel:
        return self._scene.compile()

    def render_data(self, i: int) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """One world's pose with everything there is to see; see `Physics.world`."""
        qpos, qvel, mocap = (self._state[name][i].cpu().numpy() for name in ("qpos", "qvel", "mocap_pos"))
        return posed_data(self._visible, qpos, qvel, mocap)

    def close(self) -> None:
        """Free the worlds."""
        del self._all, self._few, self._state


def _say_if_it_has_to_compile() -> None:
    cache = wp.config.kernel_cache_dir
    if cache is not None and not any(Path(cache).glob("*mujoco_warp*")):
        print("mujoco_warp compiles its kernels: a minute or two, once a machine", file=sys.stderr, flush=True)


def _choose(mask: Tensor, first: Tensor, second: Tensor) -> Tensor:
    return torch.where(mask.view(-1, *[1] * (second.dim() - 1)), first, second)
