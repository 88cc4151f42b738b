"""`MountEnv`: a batch of worlds behind TorchRL's `EnvBase`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from skatemount.devices import torch_threads
from skatemount.envs.mdp import Outcome
from skatemount.envs.physics.base import Physics, make_physics
from skatemount.envs.randomization import Pushes, Randomizer
from skatemount.envs.starts import Change, Place, StartQueue
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.statistics import EpisodeStatistics
from skatemount.envs.task import MountTask

Listener = Callable[[EpisodeState, Outcome, Tensor], None]

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
        enough: End an episode, as at its time limit, once the robot has stood on the board for so many seconds; none
            to let it stand.

    Attributes:
        task: The task.
        physics: The engine.
        statistics: What happened in the episodes that ended.
        listeners: Called after every step with the episodes, what the step led to, and which episodes it ended.
    """

    def __init__(
        self,
        task: MountTask,
        num_worlds: int | None = None,
        threads: int | None = None,
        seed: int = 0,
        random_phase: bool = False,
        enough: float | None = None,
    ):
        config = task.config.physics
        physics = make_physics(task.scene, config, num_worlds, threads)
        n = physics.num_worlds
        super().__init__(device=physics.device, batch_size=torch.Size([n]))
        self.task = task
        self.physics: Physics = physics
        self.generator = torch.Generator(physics.device)
        self.mdp = task.make_mdp(self.generator)
        if enough is not None:
            self.mdp.enough = enough
        self.statistics = EpisodeStatistics(self.mdp, n)
        self.listeners: list[Listener] = [self.statistics.add]
        self._place: Place | None = None
        self._change: Change | None = None
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
        """The present state of every world."""
        if self._sim is None:
            self._sim = self.physics.state()
        return self._sim

    @property
    def episode(self) -> EpisodeState:
        """The present episode of every world; at a step that is done, the one that ends there."""
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
        self._draw_starts_anew()
        self._pushes = Pushes(config.randomization, n, self.mdp.context.control_step, self.generator)
        physics = self.physics
        self._randomizer = Randomizer(config.randomization, physics.index, physics.model, self.generator)
        self._randomizer.build_worlds(physics)
        self._episode = EpisodeState.zeros(n, self.mdp.observation.size, self.device)
        self._begun = False
        self.statistics.clear()

    def _reset(self, tensordict: TensorDictBase | None, **kwargs: Any) -> TensorDictBase:
        with torch_threads(self._torch_threads):
            return self._begin(tensordict)

    def _begin(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        mask = torch.ones(self.num_worlds, dtype=torch.bool, device=self.device)
        if tensordict is not None and "_reset" in tensordict.keys():
            mask = tensordict["_reset"].reshape(self.num_worlds)
        rows, sim, begun = self._restart(mask)
        # Nobody looks at the rows of worlds that go on, so only those that start anew are worked out.
        observation, privileged = (
            v.new_zeros(self.num_worlds, v.shape[1]).index_copy_(0, rows, v) for v in self.mdp.observe(sim, begun)
        )
        values = {"observation": observation, "privileged": privileged, "success": torch.zeros_like(mask).unsqueeze(1)}
        return TensorDict(values, batch_size=self.batch_size)

    def _restart(self, mask: Tensor) -> tuple[Tensor, SimState, EpisodeState]:
        """Start new episodes in the worlds of a mask; their rows, states and episodes."""
        self._randomizer.new_episodes(self.physics, mask)
        start = self._queue.take(mask)
        self.physics.reset(mask, start)
        if self._pushes.active:
            self._pushes.restart(mask)
        self.statistics.restart(mask)
        rows = mask.nonzero().squeeze(1)
        sim = self.physics.state(rows)
        begun = self.mdp.begin(sim, start.bin[rows])
        if self._random_phase and not self._begun:
            most, here = self.mdp.context.episode_steps, self.device
            begun.step = torch.randint(most, (len(rows),), generator=self.generator, device=here)
            # How an episode ends that began in the middle says nothing of the start that it would have had.
            begun.bin = torch.full_like(begun.bin, -1)
            self.statistics.leave_out()
        self._begun = True
        # A copy: what the step handed out (``terminated``) shares its memory. Mypy does not see tensorclass's own.
        episode = self._episode.clone()  # type: ignore[attr-defined]
        episode[rows] = begun
        self._episode = episode
        self._sim = None
        return rows, sim, begun

    def place_starts(self, place: Place) -> None:
        """Let a curriculum choose where starts are, from the next start that is drawn on.

        Args:
            place: Draws places; what it does not say follows the task's start settings. Call again when its choice
                changes, as starts are drawn ahead.
        """
        self._place = place
        self._draw_starts_anew()

    def change_starts(self, change: Change) -> None:
        """Let something make other starts of those that are drawn, from the next one that is drawn on.

        Args:
            change: Takes and returns starts.
        """
        self._change = change
        self._draw_starts_anew()

    def _draw_starts_anew(self) -> None:
        sampler = self.task.make_sampler(self._place, self.device)
        self._queue = StartQueue(sampler, max(self.num_worlds, 1024), self.generator, self._change)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        with torch_threads(self._torch_threads):
            return self._advance(tensordict["action"])

    def _advance(self, action: Tensor) -> TensorDictBase:
        if self._pushes.active:
            self.physics.push(*self._pushes.due())
        self.physics.step(self.mdp.targets(action), self._substeps)
        sim = self._sim = self.physics.state()
        diverged = self.physics.diverged()
        outcome = self.mdp.advance(sim, self._episode, action, diverged)
        done = outcome.terminated | outcome.truncated
        for listener in self.listeners:
            listener(self._episode, outcome, done)
        # What a failed world shows may be of any size, and would stay in the running means of the networks.
        observation, privileged = (
            v.masked_fill(diverged.unsqueeze(1), 0.0) for v in self.mdp.observe(sim, self._episode)
        )
        values = {"observation": observation, "privileged": privileged, "success": outcome.succeeded.unsqueeze(1)}
        result = TensorDict(values, batch_size=self.batch_size)
        result["reward"] = outcome.reward.unsqueeze(1)
        result["done"] = done.unsqueeze(1)
        result["terminated"] = outcome.terminated.unsqueeze(1)
        result["truncated"] = outcome.truncated.unsqueeze(1)
        return result

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Stop the engine."""
        if not self.is_closed:
            self.physics.close()
        super().close(raise_if_closed=raise_if_closed)
