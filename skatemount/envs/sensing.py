"""Sensing: the state as the robot's sensors and camera show it to the policy, and targets that arrive late.

`Sensing` turns the true `SimState` into a *sensed* one, from which the policy's observation and the command are
computed. There is one sensed pose of the board, so all terms about the board agree. Rewards, terminations, success and
the critic's own observation use the true state.
"""

from __future__ import annotations

import math
from typing import Any, TypeVar

import torch
from torch import Tensor

from skatemount.envs.config.sensing import SensingConfig
from skatemount.envs.geometry import quat_to_matrix
from skatemount.envs.legs import Legs
from skatemount.envs.randomization import ModelFields
from skatemount.envs.sampling import coarse_noise, uniform
from skatemount.envs.state import EpisodeState, SimState
from skatemount.utils.errors import ConfigError

_POSE = 12
"""Number of values of a pose: a position and a rotation matrix."""

AnyState = TypeVar("AnyState", SimState, EpisodeState)


def rotation_of(vector: Tensor) -> Tensor:
    """Convert rotation vectors to rotation matrices.

    Args:
        vector: ``[N, 3]``, the axis times the angle, rad.

    Returns:
        ``[N, 3, 3]``.
    """
    angle = torch.linalg.vector_norm(vector, dim=-1, keepdim=True)
    # sin(a / 2) / a, also at 0.
    imaginary = vector * (torch.sinc(angle / (2 * math.pi)) / 2)
    return quat_to_matrix(torch.cat((torch.cos(angle / 2), imaginary), -1))


class Sensing:
    """The sensors of a batch of worlds.

    The memory holds what was drawn for each world's episode, and the measurements of the last control steps.

    Args:
        config: Sizes of the errors and delays.
        legs: Kinematics of the robot, on the device of the states.
        control_step: Time between two actions, s.
        timestep: Length of a physics step, s.
        generator: Source of randomness.
    """

    def __init__(
        self, config: SensingConfig, legs: Legs, control_step: float, timestep: float, generator: torch.Generator
    ):
        config.validate()
        self.config = config
        self._legs, self._generator = legs, generator
        self._end = torch.ones(1, device=generator.device)
        self._control_step, self._timestep = control_step, timestep
        joints = legs.num_joints
        self._delays = config.delay_steps(timestep)
        rot_bias, rot_jitter = math.radians(config.board_rot_bias), math.radians(config.board_rot_jitter)
        here = generator.device
        sizes = [config.board_pos_bias] * 3 + [rot_bias] * 3 + [config.encoder_offset] * joints
        self._constant = torch.tensor(sizes, device=here)
        sizes = [config.board_pos_jitter] * 3 + [rot_jitter] * 3 + [config.gyro_noise] * 3 + [config.gravity_noise] * 3
        # The last number decides whether the board is seen.
        self._each_step = torch.tensor(sizes + [config.joint_vel_noise] * joints + [1.0], device=here)
        self._memory: dict[str, Tensor] = {}

    @property
    def active(self) -> bool:
        """True if the sensed state differs from the true one."""
        return not self.config.senses_truth

    @property
    def noise_size(self) -> int:
        """Number of errors that are drawn for a world in each control step."""
        return len(self._each_step)

    def allocate(self, num_worlds: int) -> None:
        """Make the memory for a number of worlds whose episodes begin; an earlier one is dropped."""
        if not self.active:
            return
        (_, oldest), (_, latest) = self.config.board_age, self.config.latency
        here = self._generator.device
        self._memory = {
            "constant": torch.zeros(num_worlds, len(self._constant), device=here),
            "board_age": torch.zeros(num_worlds, dtype=torch.int64, device=here),
            # Pose, and 1 if the board was found; the newest first.
            "measured": torch.zeros(num_worlds, oldest + 1, _POSE + 1, device=here),
            # The pose in use and its age in control steps.
            "used": torch.zeros(num_worlds, _POSE + 1, device=here),
        }
        if latest:
            self._memory["latency"] = torch.zeros(num_worlds, dtype=torch.int64, device=here)

    def delay_targets(self, physics: ModelFields, rows: Tensor) -> None:
        """Draw the delays of the targets for new episodes and give them to the engine.

        Args:
            physics: The worlds.
            rows: ``[K]`` int64, the worlds that are reset.
        """
        low, high = self._delays
        if not high:
            return
        steps = torch.randint(low, high + 1, (len(rows), 1), generator=self._generator, device=rows.device)
        delay = physics.field("actuator_delay")
        # Half a step less than a whole number: the engine takes the newest target that is at least as old, so rounding
        # of the time cannot change which one it takes.
        delay[rows] = ((steps - 0.5).clamp(min=0.0) * self._timestep).to(delay.dtype)

    def targets(self, targets: Tensor) -> Tensor:
        """Return the targets that the engine needs for controllers which read the encoders.

        A controller's torque depends on target minus measured angle, so an offset of the encoder acts as one of the
        target with the other sign.

        Args:
            targets: ``[N, J]`` rad, of the policy.
        """
        return targets - self._memory["constant"][:, 6:] if self.config.encoder_offset else targets

    def begin(self, sim: SimState, episode: EpisodeState, rows: Tensor | None = None) -> SimState:
        """Draw the constant errors of new episodes, and sense their start states.

        Args:
            sim: ``[K]`` start states.
            episode: ``[K]`` episodes at their start, with their contacts.
            rows: ``[K]`` int64, the worlds of the states. None if they are all worlds that there are.

        Returns:
            ``[K]`` sensed states; ``sim`` itself if they do not differ.
        """
        if not self.active:
            return sim
        n = sim.base_pos.shape[0]
        if rows is None:
            self.allocate(n)
            rows = torch.arange(n, device=self._generator.device)
        fresh = {"constant": self._constant * uniform((n, len(self._constant)), self._generator, (-1.0, 1.0))}
        fresh["board_age"] = self._draw(self.config.board_age, n)
        if "latency" in self._memory:
            fresh["latency"] = self._draw(self.config.latency, n)
        noise = self._noise(n)
        pose = self._measure(sim, fresh, noise)
        # The robot stood still before and has seen the board.
        pose[:, -1] = 1.0
        fresh["measured"] = pose.unsqueeze(1).expand(-1, self._memory["measured"].shape[1], -1)
        fresh["used"] = torch.cat((pose[:, :-1], fresh["board_age"].unsqueeze(1)), 1)
        sensed = self._sensed(sim, fresh, noise)
        if "latency" in fresh:
            packed = self._packed(sensed, episode)
            fresh["late"] = packed.unsqueeze(1).expand(-1, self.config.latency[1] + 1, -1)
            if "late" not in self._memory:
                worlds = len(self._memory["constant"])
                self._memory["late"] = packed.new_zeros(worlds, *fresh["late"].shape[1:])
            sensed = self._unpacked(sensed, fresh)
        for name, values in fresh.items():
            self._memory[name][rows] = values
        return sensed

    def sense(self, sim: SimState, episode: EpisodeState, drawn: Tensor | None = None) -> SimState:
        """Sense the states after a control step, once in each step.

        Args:
            sim: ``[N]`` states.
            episode: ``[N]`` episodes, with the contacts after the step.
            drawn: ``[N, noise_size]`` from -1 to 1, the errors of this step as shares of their sizes; drawn here if
                None.

        Returns:
            ``[N]`` sensed states; ``sim`` itself if they do not differ.
        """
        if not self.active:
            return sim
        memory, n = self._memory, sim.base_pos.shape[0]
        noise = self._noise(n) if drawn is None else self._each_step * drawn
        pose = self._measure(sim, memory, noise).unsqueeze(1)
        memory["measured"] = torch.cat((pose, memory["measured"][:, :-1]), 1)
        arrived = _pick(memory["measured"], memory["board_age"])
        found = arrived[:, -1:] > 0
        age = torch.where(found, memory["board_age"].unsqueeze(1), memory["used"][:, -1:] + 1)
        memory["used"] = torch.cat((torch.where(found, arrived[:, :-1], memory["used"][:, :-1]), age), 1)
        sensed = self._sensed(sim, memory, noise)
        if "late" in memory:
            packed = self._packed(sensed, episode).unsqueeze(1)
            memory["late"] = torch.cat((packed, memory["late"][:, :-1]), 1)
            sensed = self._unpacked(sensed, memory)
        return sensed

    def contacts(self, episode: EpisodeState, rows: Tensor | None = None) -> EpisodeState:
        """Return the episodes with the contacts of the feet as the robot's sensors show them, which may be late.

        Args:
            episode: ``[K]`` episodes.
            rows: ``[K]`` int64, their worlds; all if None.

        Returns:
            ``episode`` itself if nothing is late, otherwise a shallow copy.
        """
        if "late" not in self._memory:
            return episode
        memory = self._memory if rows is None else {name: self._memory[name][rows] for name in ("late", "latency")}
        feet = episode.on_deck.shape[1]
        on_deck, off_time = _pick(memory["late"], memory["latency"])[:, -2 * feet :].split(feet, 1)
        seen = _copied(episode)
        seen.on_deck, seen.off_time = on_deck > 0, off_time
        return seen

    def state_dict(self) -> dict[str, Tensor]:
        """Return a copy of the memory, tensors by name whose first dimension is the worlds."""
        return {name: values.clone() for name, values in self._memory.items()}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restore what `state_dict` returned.

        Raises:
            ConfigError: It is the memory of other settings.
        """
        if missing := self._memory.keys() - state.keys():
            raise ConfigError(f"sensing: the saved state lacks {', '.join(sorted(missing))}; it has other settings")
        self._memory = {name: values.to(self._generator.device, copy=True) for name, values in state.items()}

    def _draw(self, bounds: list[int], n: int) -> Tensor:
        low, high = bounds
        return torch.randint(low, high + 1, (n,), generator=self._generator, device=self._generator.device)

    def _noise(self, n: int) -> Tensor:
        """Draw the errors of one control step, ``[N, 13 + J]``; the last column is from -1 to 1."""
        return self._each_step * coarse_noise((n, len(self._each_step)), self._generator)

    def _measure(self, sim: SimState, memory: dict[str, Tensor], noise: Tensor) -> Tensor:
        """Measure the board's pose in the trunk frame.

        Returns:
            ``[N, 13]``: position, rotation matrix by rows, and 1 if the board was found, else 0.
        """
        error = memory["constant"][:, :6] + noise[:, :6]
        position = sim.board_pos_base + error[:, :3]
        rotation = rotation_of(error[:, 3:]) @ sim.board_rot_base
        found = (noise[:, -1:] < 2 * self.config.board_seen - 1).to(position.dtype)
        return torch.cat((position, rotation.flatten(1), found), 1)

    def _sensed(self, sim: SimState, memory: dict[str, Tensor], noise: Tensor) -> SimState:
        """Return a copy of the true state with the values of the sensors, the latency not included."""
        used = memory["used"]
        sensed = _copied(sim)
        sensed.board_pos_base = used[:, :3]
        sensed.board_rot_base = used[:, 3:_POSE].unflatten(1, (3, 3))
        sensed.board_age = used[:, -1] * self._control_step
        sensed.base_ang_vel = sim.base_ang_vel + noise[:, 6:9]
        sensed.joint_vel = sim.joint_vel + noise[:, 12:-1]
        if self.config.gravity_noise:
            sensed.gravity = torch.nn.functional.normalize(sim.gravity + noise[:, 9:12], dim=-1)
        if self.config.encoder_offset:
            sensed.joint_pos = sim.joint_pos + memory["constant"][:, 6:]
            sensed.foot_pos_base = self._legs.points(sensed.joint_pos, self._end, self._end)[1].squeeze(-2)
        to_foot = sensed.foot_pos_base - sensed.board_pos_base.unsqueeze(1)
        sensed.foot_pos_board = to_foot @ sensed.board_rot_base
        return sensed

    def _packed(self, sensed: SimState, episode: EpisodeState) -> Tensor:
        """Return all values of sensed states in one tensor, ``[N, V]``, the contacts of the episodes last."""
        parts = [*_tensors(sensed).values(), episode.on_deck, episode.off_time]
        return torch.cat([part.float().reshape(len(part), -1) for part in parts], 1)

    def _unpacked(self, present: SimState, memory: dict[str, Tensor]) -> SimState:
        """Return the sensed states that each world's latency lets through, with that much more age of the board."""
        values, start, sensed = _pick(memory["late"], memory["latency"]), 0, _copied(present)
        for name, like in _tensors(present).items():
            size = math.prod(like.shape[1:])
            part = values[:, start : start + size].reshape(like.shape)
            setattr(sensed, name, part > 0 if like.dtype == torch.bool else part)
            start += size
        assert sensed.board_age is not None
        sensed.board_age = sensed.board_age + memory["latency"] * self._control_step
        return sensed


def _copied(state: AnyState) -> AnyState:
    """Return a shallow copy, whose tensors can be replaced."""
    return state.copy()  # type: ignore[attr-defined]  # Mypy does not know tensorclass's methods.


def _tensors(state: Any) -> dict[str, Tensor]:
    return dict(state.items())


def _pick(history: Tensor, age: Tensor) -> Tensor:
    """Return the entry of each world that is some control steps old.

    Args:
        history: ``[N, T, V]``, the newest first.
        age: ``[N]`` int64.

    Returns:
        ``[N, V]``.
    """
    return history[torch.arange(len(age), device=age.device), age]
