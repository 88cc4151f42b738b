"""`MountEnv`: a batch of worlds as a TorchRL environment."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NoReturn

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from skatemount.envs.boards import Boards
from skatemount.envs.divergence import Divergence
from skatemount.envs.drive import Drive
from skatemount.envs.episode_statistics import EpisodeStatistics
from skatemount.envs.mdp import StepResult
from skatemount.envs.physics.base import Physics, StartState
from skatemount.envs.physics.factory import make_physics
from skatemount.envs.randomization import Pushes, Randomizer
from skatemount.envs.rolling import RollingResistance
from skatemount.envs.start_queue import make_queue
from skatemount.envs.starts import StartPoseSampler, StartTransform
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.task import MountTask
from skatemount.utils.devices import plain_defaults, torch_threads

Listener = Callable[[EpisodeState, StepResult, Tensor], None]
"""A function that gets the episodes after a step, the result of the step, and ``[N]`` bool: the episodes that ended."""

MANY_WORLDS = 4096
"""Number of worlds from which torch's threads pay off: with fewer, waking them costs more than they save."""


class MountEnv(EnvBase):
    """N worlds of a `MountTask` that are stepped together.

        env = MountEnv(MountTask(stage="unfixed"), num_worlds=512)
        env.rollout(100, break_when_any_done=False)

    Its keys are:

    - ``observation``, ``[N, D]``: the actor's observation.
    - ``privileged``, ``[N, P]``: the values that only the critic gets in addition.
    - ``action``, ``[N, J]``: targets of the J joints relative to the default pose, in units of the action scale,
      clipped.
    - ``success``, ``[N, 1]``: true in the last step of an episode that succeeded.
    - ``reward``, ``done``, ``terminated`` and ``truncated``, ``[N, 1]``.

    A mask under ``_reset`` chooses the worlds of a reset. The ``next`` entry of a step holds the last observation of an
    episode that ended, not the first one of the next episode.

    Args:
        task: The task.
        num_worlds: Number of worlds; ``physics.num_worlds`` of the task if None.
        threads: Number of physics threads; ``physics.threads`` of the task if None, every core if 0.
        seed: Seed of all random numbers. Results do not depend on the number of threads.
        random_phase: True if the first episodes begin at random times of their length, so that they do not all end in
            the same step.
        max_mounted_time: Time that the robot has been mounted after which an episode is truncated, s; no such limit if
            None.

    Attributes:
        task: The task.
        physics: The engine.
        boards: The board of each world; None if all have the same.
        divergence: Counts the worlds whose physics fails, and copies them on request.
        statistics: Statistics of the episodes that ended.
        torch_threads: Number of torch's threads that a step uses, and that suits a policy's actions; None for all.
        listeners: Functions that are called after every step. They must copy the parts of the episodes that they keep.
    """

    @plain_defaults
    def __init__(
        self,
        task: MountTask,
        num_worlds: int | None = None,
        threads: int | None = None,
        seed: int = 0,
        random_phase: bool = False,
        max_mounted_time: float | None = None,
    ):
        config = task.config.physics
        physics = make_physics(task.scene, config, num_worlds, threads)
        n = physics.num_worlds
        super().__init__(device=physics.device, batch_size=torch.Size([n]))
        # TorchRL takes an environment for closed until its first step.
        self.is_closed = False
        self.task = task
        self.physics: Physics = physics
        self.boards: Boards | None = None
        self.divergence = Divergence(physics, task.config)
        self.generator = torch.Generator(physics.device)
        self.mdp = task.make_mdp(self.generator)
        if max_mounted_time is not None:
            self.mdp.max_mounted_time = max_mounted_time
        self.statistics = EpisodeStatistics(self.mdp, n)
        self.listeners: list[Listener] = [self.statistics.add]
        self._sample_poses: StartPoseSampler | None = None
        self._transform_starts: StartTransform | None = None
        self._sim: SimState | None = None
        self._substeps = config.substeps
        self._random_phase = random_phase
        self.torch_threads = 1 if n < MANY_WORLDS else None
        self._make_specs(n)
        self.set_seed(seed)

    @property
    def num_worlds(self) -> int:
        """Number of worlds."""
        return self.batch_size[0]

    @property
    def sim(self) -> SimState:
        """The present state of every world; copy a tensor before you change it in place or differentiate it."""
        if self._sim is None:
            self._check_open()
            self._sim = self.physics.state()
        return self._sim

    @property
    def episode(self) -> EpisodeState:
        """The present episode of every world; after a step that is done, the episode that ended.

        Copy a tensor before you keep it, change it in place or differentiate it.
        """
        return self._episode

    def _make_specs(self, n: int) -> None:
        joints = self.mdp.context.layout.num_joints
        bound = self.task.scene.robot.config.action_clip
        self.observation_spec = Composite(
            observation=Unbounded((n, self.mdp.observation.size), device=self.device),
            privileged=Unbounded((n, self.mdp.privileged.size), device=self.device),
            success=self._flag(n),
            shape=(n,),
        )
        self.action_spec = Bounded(-bound, bound, shape=(n, joints), dtype=torch.float32, device=self.device)
        self.reward_spec = Unbounded((n, 1), device=self.device)
        flags = {key: self._flag(n) for key in ("done", "terminated", "truncated")}
        self.full_done_spec = Composite(**flags, shape=(n,))

    def _flag(self, n: int) -> Binary:
        return Binary(n=1, shape=(n, 1), dtype=torch.bool, device=self.device)

    @plain_defaults
    def _set_seed(self, seed: int | None) -> None:
        """Draw everything random again from a seed: physics, start states, pushes and noise."""
        self.generator.manual_seed(0 if seed is None else int(seed))
        config, n = self.task.config, self.num_worlds
        physics = self.physics
        self.boards, of_boards = self.task.give_boards(physics, 0 if seed is None else int(seed))
        mass = None if self.boards is None else self.boards.sizes.mass
        self._resistance = RollingResistance(
            config.board.rolling_resistance, physics.model, physics.index, physics.device, mass
        )
        self._drive = Drive(config.start.drive, self._resistance)
        self._rebuild_start_queue()
        self._pushes = Pushes(config.randomization, n, self.mdp.context.control_step, self.generator)
        self._randomizer = Randomizer(config.randomization, physics.index, physics.model, self.generator, of_boards)
        self._randomizer.build_worlds(physics)
        self._episode = self.mdp.no_episodes(n)
        self._privileged = torch.zeros(n, self.mdp.privileged.size, device=self.device)
        self._begun = self._resumes = False
        self.mdp.allocate(n)
        self.statistics.clear()

    @plain_defaults
    def _reset(self, tensordict: TensorDictBase | None, **kwargs: Any) -> TensorDictBase:
        mask = torch.ones(self.num_worlds, dtype=torch.bool, device=self.device)
        if tensordict is not None and "_reset" in tensordict.keys():
            mask = tensordict["_reset"].reshape(self.num_worlds)
        self._check_open()
        if self._resumes:
            values = self._present_observation()
            self._resumes = False
        elif mask.all():
            _, first = self._restart(mask)
            values = {key: value.clone() for key, value in first.items()}  # outside of inference mode
        else:
            # Transforms such as VecNorm count all rows, so worlds that go on return their present observation.
            values = self._present_observation()
            if mask.any():
                rows, first = self._restart(mask)
                for key, value in first.items():
                    values[key].index_copy_(0, rows, value)
        values["success"] = torch.zeros_like(mask).unsqueeze(1)
        return TensorDict(values, batch_size=self.batch_size, device=self.device)

    def _present_observation(self) -> dict[str, Tensor]:
        """Return the present observations of every world by key, those of a world whose physics failed as zeros."""
        present = {"observation": self._episode.observation, "privileged": self._privileged}
        failed = self.physics.diverged().nonzero().squeeze(1)
        return {key: value.index_fill(0, failed, 0.0) for key, value in present.items()}

    @plain_defaults
    def maybe_reset(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Begin new episodes in the worlds whose episode ended.

        This does the same as `EnvBase.maybe_reset`, but knows the keys of this environment and so takes less time. With
        many worlds it happens in nearly every step.

        Args:
            tensordict: The result of `torchrl.envs.utils.step_mdp`; updated in place.

        Returns:
            The same tensordict.
        """
        done = tensordict["done"]
        if done.any():
            rows, first = self._restart(done.squeeze(1))
            for key, value in first.items():
                tensordict[key] = tensordict[key].index_copy(0, rows, value)
            for key in ("done", "terminated", "truncated", "success"):
                tensordict[key] = torch.zeros_like(done)
        return tensordict

    def _restart(self, mask: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
        """Begin new episodes in the worlds of a mask.

        Args:
            mask: ``[N]`` bool.

        Returns:
            ``[K]`` int64, the chosen worlds, and their first observations by key.
        """
        with torch_threads(self.torch_threads):
            rows = mask.nonzero().squeeze(1)
            return rows, self._begin(mask, rows, self._queue.take_for(rows))

    def _begin(self, mask: Tensor, rows: Tensor, start: StartState) -> dict[str, Tensor]:
        with torch.inference_mode():
            self._randomizer.new_episodes(self.physics, rows)
            self.mdp.sensing.delay_targets(self.physics, rows)
            if self._resistance.active:
                self._resistance.restart(self.physics, rows)
            self.physics.reset(mask, start)
            self.divergence.begin(rows)
            if self._pushes.active:
                self._pushes.restart(mask)
            self.statistics.restart(mask)
            sim = self.physics.state(rows)
            begun = self.mdp.begin(sim, start.bin, rows, self._randomizer.dynamics(self.physics, rows))
            if self._random_phase and not self._begun:
                most, here = self.mdp.context.episode_steps, self.device
                begun.step = torch.randint(most, (len(rows),), generator=self.generator, device=here)
                # These episodes are cut short, so their success says nothing about their start states.
                begun.bin = torch.full_like(begun.bin, -1)
                self.statistics.exclude_running()
            self._begun = True
            self._episode[rows] = begun  # type: ignore[index]  # Mypy does not know tensorclass's method.
            self._sim = None
            first = self._observe(sim, begun)
            self._privileged = self._privileged.index_copy(0, rows, first["privileged"])
            return first

    def set_start_sampler(self, sample_poses: StartPoseSampler) -> None:
        """Draw the poses of all start states from now on with a function, such as a curriculum's.

        Start states are drawn ahead, so call this again whenever the distribution of the function changes.

        Args:
            sample_poses: Draws the poses. Everything else follows the start settings of the task.
        """
        self._sample_poses = sample_poses
        self._rebuild_start_queue()

    def set_start_transform(self, transform: StartTransform) -> None:
        """Apply a transform to all start states that are drawn from now on.

        Args:
            transform: Takes a batch of start states and returns one of the same size.
        """
        self._transform_starts = transform
        self._rebuild_start_queue()

    @plain_defaults
    def _rebuild_start_queue(self) -> None:
        sampler = self.task.make_sampler(self._sample_poses, self.device, self.boards)
        self._queue = make_queue(sampler, self.num_worlds, self.generator, self._transform_starts)

    @plain_defaults
    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        self._check_open()
        with torch_threads(self.torch_threads):
            # A step is several hundred small operations, which take less time to launch without autograd.
            with torch.inference_mode():
                outcome, observations, failed = self._advance(tensordict["action"])
            done = outcome.terminated | outcome.truncated
            for listener in self.listeners:
                listener(self._episode, outcome, done)
            # The results are copies outside of inference mode, which callers may change and differentiate. Observations
            # of a failed world may be of any size and would spoil the running means of the networks.
            values = {key: value.index_fill(0, failed, 0.0) for key, value in observations.items()}
            flags = {"done": done, "terminated": outcome.terminated, "truncated": outcome.truncated}
            for key, value in {"success": outcome.succeeded, "reward": outcome.reward, **flags}.items():
                values[key] = value.clone().unsqueeze(1)
            # The device is set because `EnvBase` would copy all tensors again without it.
            return TensorDict(values, batch_size=self.batch_size, device=self.device)

    def _advance(self, action: Tensor) -> tuple[StepResult, dict[str, Tensor], Tensor]:
        """Simulate a control step.

        Args:
            action: ``[N, J]``.

        Returns:
            The result of the step, the observations after it by key, and ``[K]`` int64, the worlds whose physics
            failed.
        """
        if self._pushes.active:
            self.physics.push(*self._pushes.due())
        if self._resistance.active:
            self._resistance.apply(self.physics, self.sim)
        if self._drive.active:
            self.physics.pull_board(self._drive.force(self.sim, self._episode))
        targets = self.mdp.targets(action)
        self.divergence.before_step()
        self.physics.step(targets, self._substeps)
        sim = self._sim = self.physics.state()
        diverged = self.physics.diverged()
        failed = diverged.nonzero().squeeze(1)
        outcome = self.mdp.advance(sim, self._episode, action, diverged)
        self.divergence.after_step(failed, action, targets, self._episode.step, self._substeps)
        observations = self._observe(sim, self._episode)
        # Kept because a term with memory is computed once in each step.
        self._privileged = observations["privileged"]
        return outcome, observations, failed

    def _observe(self, sim: SimState, episode: EpisodeState) -> dict[str, Tensor]:
        observation, privileged = self.mdp.observe(sim, episode)
        return {"observation": observation, "privileged": privileged}

    def world_state(self) -> dict[str, Any]:
        """Return copies of all that shapes the worlds' future, in nested dicts; see `load_world_state`."""
        return {
            "physics": self.physics.state_dict(),
            "memory": self.mdp.memory.state_dict(),
            "sensing": self.mdp.sensing.state_dict(),
            "privileged": self._privileged.clone(),
            # Mypy does not know the methods of a tensorclass.
            "episode": dict(self._episode.clone().to_tensordict()),  # type: ignore[attr-defined]
            "statistics": self.statistics.state_dict(),
            "pushes": self._pushes.state_dict(),
            "starts": self._queue.state_dict(),
            "generator": self.generator.get_state(),
        }

    @plain_defaults
    def load_world_state(self, state: dict[str, Any]) -> None:
        """Restore the worlds in the middle of their episodes.

        The reset that follows, with which a collector or a rollout begins, returns their present observations and
        begins no new episodes.

        Args:
            state: What `world_state` returned, of an environment of the same task, seed and number of worlds.
        """
        self.physics.load_state_dict(state["physics"])
        # Saved states of older versions lack some tensors of an episode, and the sensing.
        episode = self.mdp.no_episodes(self.num_worlds).to_tensordict()  # type: ignore[attr-defined]
        episode.update({name: values.to(self.device) for name, values in state["episode"].items()})
        self._episode = EpisodeState.from_tensordict(episode)  # type: ignore[attr-defined]
        self.mdp.memory.load_state_dict(state["memory"])
        self.mdp.sensing.load_state_dict(state.get("sensing", {}))
        self._privileged = state["privileged"].to(self.device)
        self.statistics.load_state_dict(state["statistics"])
        self._pushes.load_state_dict(state["pushes"])
        self._queue.load_state_dict(state["starts"])
        self.generator.set_state(state["generator"])
        self._sim = None
        self._begun = self._resumes = True

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Stop the engine's threads and free the worlds; a second call does nothing.

        Args:
            raise_if_closed: Has no effect; TorchRL's interface has it.
        """
        if not self.is_closed:
            super().close(raise_if_closed=raise_if_closed)
            self.physics.close()
            # The largest of the rest, which a closed environment would keep as long as it is referenced.
            del self._queue, self._randomizer, self._pushes, self._drive, self._episode, self._privileged
            self._sim = None

    def _check_open(self) -> None:
        if self.is_closed:
            raise RuntimeError("this MountEnv is closed; make a new one")

    def __repr__(self) -> str:
        state = ", closed" if self.is_closed else ""
        return f"MountEnv({self.num_worlds} worlds, {self.physics.description}, device={self.device}{state})"

    def __reduce__(self) -> NoReturn:
        raise TypeError(
            "a MountEnv cannot be pickled or copied, because its engine lives in this process; pass a function that "
            "makes one, such as lambda: MountEnv(MountTask(stage='unfixed'), num_worlds=64)"
        )
