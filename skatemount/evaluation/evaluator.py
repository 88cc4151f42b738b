"""Evaluation of a policy: whole episodes, deterministic actions, seeds that training does not use."""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import torch
from torchrl.envs.utils import ExplorationType, set_exploration_type

from skatemount.agents.switching import Policy, SwitchingPolicy
from skatemount.config import Config
from skatemount.envs.mount_env import MountEnv
from skatemount.envs.task import MountTask
from skatemount.evaluation.records import EpisodeRecords, Recorder
from skatemount.evaluation.results import Evaluation
from skatemount.utils.devices import torch_threads
from skatemount.utils.errors import ConfigError

EVALUATION_SEED = 1_000_003
"""Added to ``seed`` in evaluations and films, so that they never repeat a training's start states."""

NUM_WORLDS = 256
"""Worlds stepped together where nobody asks for another number. It is no setting of the machine's, and does not depend
on how many episodes are asked for, because the worlds that are drawn depend on it."""

TIME_LIMIT = {"mount": "not_mounted", "gait": "not_followed"}
"""What a failure is called that nothing ended before the time limit, by the task's criterion."""


def mix_seeds(*parts: int) -> int:
    """One seed made of several, so that neighbours of one do not meet neighbours of another.

    Torch's generator takes no more than the low 32 bits of a seed, so there are no more; the highest of them is set,
    which no training has whose seed is below 2**31.

    Args:
        parts: Integers, 0 or more; their order counts.
    """
    return int(np.random.SeedSequence(parts).generate_state(1)[0]) | 2**31


class Evaluator:
    """Evaluates policies in an environment that is built once.

    Each world runs one whole episode a round, and a round lasts until every episode has ended: worlds that start anew
    as soon as they are done would count short episodes, which are mostly failures, more often. Each round begins anew
    from a seed of its own, so that any episode can be repeated by its round alone, equal weights give equal numbers,
    and different weights meet the same worlds and start states.

    Args:
        config: Task to evaluate in, its noise and randomisation included.
        num_worlds: Worlds stepped together; the configuration's number if none.
        seed: Source of worlds, start states and noise.

    Attributes:
        env: The environment.
    """

    def __init__(self, config: Config, num_worlds: int | None = None, seed: int = EVALUATION_SEED) -> None:
        self.config = config
        self.seed = seed
        self.env = MountEnv(MountTask(config=config), num_worlds=num_worlds, seed=seed)
        self._recorder = Recorder(self.env)
        # Training's statistics are not asked for.
        self.env.listeners[:] = [self._recorder.add]

    def run(
        self,
        policy: Policy,
        episodes: int,
        progress: Callable[[int, int], None] | None = None,
    ) -> Evaluation:
        """Evaluate a policy with deterministic actions.

        Args:
            policy: One policy, or two that take turns; the weights stay as they are.
            episodes: How many to count; of the last round the first worlds are.
            progress: Called with the control steps done and to do.

        Returns:
            The results.

        Raises:
            ConfigError: Fewer than 1 episode.
        """
        if episodes < 1:
            raise ConfigError(f"episodes={episodes} must be at least 1")
        rounds = math.ceil(episodes / self.env.num_worlds)
        steps = self.env.mdp.context.episode_steps

        def report(number: int, step: int) -> None:
            if progress is not None:
                progress(number * steps + step, rounds * steps)

        parts = []
        for number in range(rounds):
            parts.append(self.round(policy, number, functools.partial(report, number)))
            # A round of early ends is over sooner.
            report(number + 1, 0)
        return Evaluation(records=EpisodeRecords.cat(parts)[:episodes], ends=self.ends, evaluated=self.describe())

    def round(self, policy: Policy, number: int, watch: Callable[[int], None] | None = None) -> EpisodeRecords:
        """One episode of every world, the same whenever it is run.

        Args:
            policy: One policy, or two that take turns.
            number: Which round, from 0.
            watch: Called at the start and after every control step, with the number of steps done.

        Returns:
            The episodes ``number * N`` to ``(number + 1) * N - 1`` of the seed, one a world in order.

        Raises:
            ConfigError: The engine's memory was too small for all contacts.
        """
        env, recorder = self.env, self._recorder
        watch = watch or (lambda step: None)
        with deterministic():
            env.set_seed(mix_seeds(self.seed, number))
            seen = env.reset()
            actor = policy.actor_in(env) if isinstance(policy, SwitchingPolicy) else policy.actor
            recorder.begin()
            watch(0)
            for step in range(1, env.mdp.context.episode_steps + 1):
                seen = env.step(actor(seen))["next"]
                watch(step)
                if recorder.finished:
                    break
        if lost := env.physics.overflowed():
            raise ConfigError(lost)
        return recorder.records(number * env.num_worlds)

    @property
    def ends(self) -> list[str]:
        """What a failure may end by, as `EpisodeRecords.end` counts."""
        mdp = self.env.mdp
        return [TIME_LIMIT[mdp.criterion], *mdp.termination_names()]

    def has_ended(self, world: int) -> bool:
        """Whether a world's episode of the round that is running has ended."""
        return self._recorder.has_ended(world)

    def describe(self) -> dict[str, Any]:
        """How it evaluates, as plain values."""
        return {
            "num_worlds": self.env.num_worlds,
            "episode_length": self.config.episode_length,
            "control_step": self.env.mdp.context.control_step,
        }

    def close(self) -> None:
        """Free the environment."""
        self.env.close()


@contextlib.contextmanager
def deterministic() -> Iterator[None]:
    """Mean actions, no gradients, and matrix products that are exact and the same whatever training has chosen.

    On one thread, as the sums of a matrix product come out differently with another number of them; physics, which
    takes nearly all the time, does not depend on its threads.
    """
    precision = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("highest")
    try:
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC), torch_threads(1):
            yield
    finally:
        torch.set_float32_matmul_precision(precision)
