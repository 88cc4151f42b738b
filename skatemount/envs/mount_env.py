"""`MountEnv`: a batch of worlds behind TorchRL's `EnvBase`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from skatemount.envs.episode_statistics import EpisodeStatistics
from skatemount.envs.mdp import StepResult
from skatemount.envs.physics.base import Physics, StartState
from skatemount.envs.physics.factory import make_physics
from skatemount.envs.randomization import Pushes, Randomizer
from skatemount.envs.starts import StartPoseSampler, StartQueue, StartTransform
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.task import MountTask
from skatemount.utils.devices import torch_threads

Listener = Callable[[EpisodeState, StepResult, Tensor], None]

MANY_WORLDS = 4096
"""With fewer, it takes longer to wake torch's threads for a step's small operations than they save."""


class MountEnv(EnvBase):
    """N worlds of a `MountTask`, stepped together.

        env = MountEnv(MountTask(stage="unfixed"), num_worlds=512)
        env.rollout(100, break_when_any_done=False)

    Keys: ``observation`` ``[N, D]``, the actor's; ``privileged`` ``[N, P]``, what the critic sees besides; ``action``
    ``[N, 12]``, joint position targets around the default pose, in units of the action scale, clipped; ``success``
    ``[N, 1]``, true in the last step of an episode that succeeded; ``reward``, ``done``, ``terminated`` and
    ``truncated`` ``[N, 1]``. A reset may choose worlds by ``_reset``; a step's ``next`` entry keeps the true last
    observation of an episode.

    Args:
        task: The task.
        num_worlds: Worlds stepped together; the task's setting ``physics.num_worlds`` if none.
        threads: Physics threads; the task's setting if none, every core if 0.
        seed: Source of every random number; results do not depend on the number of threads.
        random_phase: Let the first episodes start at random phases, so that they do not all end at once.
        max_mounted_time: End an episode, as at its time limit, once the robot has stood on the board for so many
            seconds; none to let it stand.

    Attributes:
        task: The task.
        physics: The engine.
        statistics: What happened in the episodes that ended.
        listeners: Called after every step with the episodes, what the step led to, and which episodes it ended. They
            copy what they keep of the episodes.
    """

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
        self.task = task
        self.physics: Physics = physics
        self.generator = torch.Generator(physics.device)
        self.mdp = task.make_mdp(self.generator)
        if max_mounted_time is not None:
            self.mdp.max_mounted_time = max_mounted_time
        self.statistics = EpisodeStatistics(self.mdp, n)
        self.listeners: list[Listener] = [self.statistics.add]
        self._place: StartPoseSampler | None = None
        self._change: StartTransform | None = None
        self._sim: SimState | None = None
        self._substeps = config.substeps
        self._random_phase = random_phase
        self._torch_threads = 1 if n < MANY_WORLDS else None
        self._make_specs(n)
        self.set_seed(seed)

    @property
    def num_worlds(self) -> int:
        """Worlds stepped together."""
        return self.batch_size[0]

    @property
    def sim(self) -> SimState:
        """The present state of every world; copy what is to be changed in place or differentiated."""
        if self._sim is None:
            self._sim = self.physics.state()
        return self._sim

    @property
    def episode(self) -> EpisodeState:
        """The present episode of every world; at a step that is done, the one that ends there.

        Copy what is to be kept, changed in place or differentiated.
        """
        return self._episode

    def _make_specs(self, n: int) -> None:
        bound = self.task.scene.robot.config.action_clip
        self.observation_spec = Composite(
            observation=Unbounded((n, self.mdp.observation.size), device=self.device),
            privileged=Unbounded((n, self.mdp.privileged.size), device=self.device),
            success=self._flag(n),
            shape=(n,),
        )
        self.action_spec = Bounded(-bound, bound, shape=(n, 12), dtype=torch.float32, device=self.device)
        self.reward_spec = Unbounded((n, 1), device=self.device)
        flags = {key: self._flag(n) for key in ("done", "terminated", "truncated")}
        self.full_done_spec = Composite(**flags, shape=(n,))

    def _flag(self, n: int) -> Binary:
        return Binary(n=1, shape=(n, 1), dtype=torch.bool, device=self.device)

    def _set_seed(self, seed: int | None) -> None:
        """Begin anew from a seed: randomised physics, queued starts, pushes and noise alike."""
        self.generator.manual_seed(0 if seed is None else int(seed))
        config, n = self.task.config, self.num_worlds
        self._rebuild_start_queue()
        self._pushes = Pushes(config.randomization, n, self.mdp.context.control_step, self.generator)
        physics = self.physics
        self._randomizer = Randomizer(config.randomization, physics.index, physics.model, self.generator)
        self._randomizer.build_worlds(physics)
        self._episode = EpisodeState.zeros(n, self.mdp.observation.size, self.device)
        self._begun = False
        self.statistics.clear()

    def _reset(self, tensordict: TensorDictBase | None, **kwargs: Any) -> TensorDictBase:
        mask = torch.ones(self.num_worlds, dtype=torch.bool, device=self.device)
        if tensordict is not None and "_reset" in tensordict.keys():
            mask = tensordict["_reset"].reshape(self.num_worlds)
        rows, seen = self._restart(mask)
        # Nobody looks at the rows of worlds that go on.
        values = {key: v.new_zeros(self.num_worlds, v.shape[1]).index_copy_(0, rows, v) for key, v in seen.items()}
        values["success"] = torch.zeros_like(mask).unsqueeze(1)
        return TensorDict(values, batch_size=self.batch_size, device=self.device)

    def maybe_reset(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Begin new episodes where the last step ended one.

        What `EnvBase` does in general, for this environment's keys alone: it is done at nearly every step.

        Args:
            tensordict: What `torchrl.envs.utils.step_mdp` makes of a step; brought up to date.
        """
        done = tensordict["done"]
        if done.any():
            rows, seen = self._restart(done.squeeze(1))
            for key, value in seen.items():
                tensordict[key] = tensordict[key].index_copy(0, rows, value)
            for key in ("done", "terminated", "truncated", "success"):
                tensordict[key] = torch.zeros_like(done)
        return tensordict

    def _restart(self, mask: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
        """Start new episodes in the worlds of a mask; their rows and what is seen there."""
        with torch_threads(self._torch_threads):
            rows = mask.nonzero().squeeze(1)
            return rows, self._begin(mask, rows, self._queue.take(len(rows)))

    def _begin(self, mask: Tensor, rows: Tensor, start: StartState) -> dict[str, Tensor]:
        with torch.inference_mode():
            self._randomizer.new_episodes(self.physics, rows)
            self.physics.reset(mask, start)
            if self._pushes.active:
                self._pushes.restart(mask)
            self.statistics.restart(mask)
            sim = self.physics.state(rows)
            begun = self.mdp.begin(sim, start.bin)
            if self._random_phase and not self._begun:
                most, here = self.mdp.context.episode_steps, self.device
                begun.step = torch.randint(most, (len(rows),), generator=self.generator, device=here)
                # How an episode ends that began in the middle says nothing of the start that it would have had.
                begun.bin = torch.full_like(begun.bin, -1)
                self.statistics.leave_out()
            self._begun = True
            self._episode[rows] = begun  # type: ignore[index]  # Mypy does not see tensorclass's own.
            self._sim = None
            return self._observe(sim, begun)

    def set_start_sampler(self, place: StartPoseSampler) -> None:
        """Let a curriculum choose where starts are, from the next start that is drawn on.

        Args:
            place: Draws places; what it does not say follows the task's start settings. Call again when its choice
                changes, as starts are drawn ahead.
        """
        self._place = place
        self._rebuild_start_queue()

    def set_start_transform(self, change: StartTransform) -> None:
        """Let something make other starts of those that are drawn, from the next one that is drawn on.

        Args:
            change: Takes and returns starts.
        """
        self._change = change
        self._rebuild_start_queue()

    def _rebuild_start_queue(self) -> None:
        sampler = self.task.make_sampler(self._place, self.device)
        self._queue = StartQueue(sampler, max(self.num_worlds, 1024), self.generator, self._change)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        with torch_threads(self._torch_threads):
            # Several hundred small operations, which start sooner without what autograd keeps of each.
            with torch.inference_mode():
                outcome, seen, failed = self._advance(tensordict["action"])
            done = outcome.terminated | outcome.truncated
            for listener in self.listeners:
                listener(self._episode, outcome, done)
            # From here on, copies that anybody may change and differentiate.
            # What a failed world shows may be of any size, and would stay in the running means of the networks.
            values = {key: value.index_fill(0, failed, 0.0) for key, value in seen.items()}
            flags = {"done": done, "terminated": outcome.terminated, "truncated": outcome.truncated}
            for key, value in {"success": outcome.succeeded, "reward": outcome.reward, **flags}.items():
                values[key] = value.clone().unsqueeze(1)
            # Without a device, `EnvBase` would copy all of it once more.
            return TensorDict(values, batch_size=self.batch_size, device=self.device)

    def _advance(self, action: Tensor) -> tuple[StepResult, dict[str, Tensor], Tensor]:
        """One control step: what it led to, what is seen then, and the rows of the worlds whose physics failed."""
        if self._pushes.active:
            self.physics.push(*self._pushes.due())
        self.physics.step(self.mdp.targets(action), self._substeps)
        sim = self._sim = self.physics.state()
        diverged = self.physics.diverged()
        outcome = self.mdp.advance(sim, self._episode, action, diverged)
        return outcome, self._observe(sim, self._episode), diverged.nonzero().squeeze(1)

    def _observe(self, sim: SimState, episode: EpisodeState) -> dict[str, Tensor]:
        observation, privileged = self.mdp.observe(sim, episode)
        return {"observation": observation, "privileged": privileged}

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Stop the engine."""
        if not self.is_closed:
            self.physics.close()
        super().close(raise_if_closed=raise_if_closed)
