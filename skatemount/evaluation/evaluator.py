"""Evaluation of a policy over whole episodes, with deterministic actions and seeds that training does not use."""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import torch
from torchrl.envs.utils import ExplorationType, set_exploration_type

from skatemount.agents.policy import Policy
from skatemount.config import TrainConfig
from skatemount.envs.mount_env import MountEnv
from skatemount.envs.task import MountTask
from skatemount.evaluation.records import EpisodeRecords, EpisodeTracker
from skatemount.evaluation.results import Evaluation
from skatemount.utils.devices import full_precision, torch_threads
from skatemount.utils.errors import ConfigError

EVALUATION_SEED = 1_000_003
"""Added to ``seed`` in evaluations and films, so that they do not repeat the initial states of a training."""

NUM_WORLDS = 256
"""Default number of worlds. The randomized worlds depend on it, so it is the same on every machine and for any number
of episodes."""


def mix_seeds(*parts: int) -> int:
    """Return one seed made of several, different for different parts.

    It has 32 bits, because torch's CPU generator uses no more. The highest bit is set, so it differs from the seed of
    every training with a seed below 2**31.

    Args:
        parts: Integers, 0 or more; their order counts.
    """
    return int(np.random.SeedSequence(parts).generate_state(1)[0]) | 2**31


class Evaluator:
    """Evaluates policies in an environment that is built once.

    Each world runs one whole episode per round, and a round lasts until every episode has ended. Worlds that restarted
    at once would count short episodes, which are mostly failures, more often. Each round has a seed of its own: any
    episode can be repeated from its round alone, equal weights give equal results, and different weights are evaluated
    in the same worlds from the same initial states.

    Args:
        config: Settings of the task, with its noise and randomization.
        num_worlds: Number of worlds; None for the number in the settings.
        seed: Seed of worlds, initial states and noise.
        torch_threads: Number of threads of the policy's matrix products, whose rounding depends on it.

    Attributes:
        env: The environment.
    """

    def __init__(
        self,
        config: TrainConfig,
        num_worlds: int | None = None,
        seed: int = EVALUATION_SEED,
        torch_threads: int = 1,
    ) -> None:
        self.config = config
        self.seed = seed
        self._torch_threads = torch_threads
        self.env = MountEnv(MountTask(config=config), num_worlds=num_worlds, seed=seed)
        self._tracker = EpisodeTracker(self.env)
        # The statistics that a training logs are not needed here.
        self.env.listeners[:] = [self._tracker.add]

    def run(
        self,
        policy: Policy,
        episodes: int,
        progress: Callable[[int, int], None] | None = None,
    ) -> Evaluation:
        """Evaluate a policy with deterministic actions.

        Args:
            policy: The policy. Its weights are not changed.
            episodes: Number of episodes. The last round counts only its first worlds.
            progress: Called with the number of control steps done and the total.

        Returns:
            The results.

        Raises:
            ConfigError: ``episodes`` is below 1.
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
            # A round is over early if every episode ended early.
            report(number + 1, 0)
        records = EpisodeRecords.cat(parts)[:episodes]
        task, layout = self.env.mdp.definition, self.env.mdp.context.layout
        most, boards = task.most(layout), self.config.boards.number
        return Evaluation(records, self.end_names, task, most, evaluated=self.describe(), boards=boards)

    def round(self, policy: Policy, number: int, watch: Callable[[int], None] | None = None) -> EpisodeRecords:
        """Run one episode in every world; the same round always gives the same episodes.

        Args:
            policy: The policy.
            number: Number of the round, from 0.
            watch: Called at the start and after every control step, with the number of steps done.

        Returns:
            The episodes ``number * N`` to ``(number + 1) * N - 1`` of the seed, one per world in order.

        Raises:
            ConfigError: The engine's memory was too small for all contacts.
        """
        env, tracker = self.env, self._tracker
        watch = watch or (lambda step: None)
        with deterministic(self._torch_threads):
            # An episode's board does not depend on the number of worlds.
            env.task.first_board = number * env.num_worlds
            env.set_seed(mix_seeds(self.seed, number))
            state = env.reset()
            actor = policy.actor_in(env)
            tracker.begin()
            watch(0)
            for step in range(1, env.mdp.context.episode_steps + 1):
                state = env.step(actor(state))["next"]
                watch(step)
                if tracker.finished:
                    break
        if lost := env.physics.overflowed():
            raise ConfigError(lost)
        return tracker.records(number * env.num_worlds)

    @property
    def end_names(self) -> list[str]:
        """Names of the ends of an episode, indexed by `EpisodeRecords.end`."""
        mdp = self.env.mdp
        return [mdp.definition.failure, *mdp.termination_names()]

    def has_ended(self, world: int) -> bool:
        """Return True if a world's episode of the current round has ended."""
        return self._tracker.has_ended(world)

    def describe(self) -> dict[str, Any]:
        """Return the settings of the evaluation as plain values."""
        return {
            "task": self.env.mdp.definition.name,
            "robot": self.config.robot.variant,
            "num_worlds": self.env.num_worlds,
            "episode_length": self.config.episode_length,
            "control_step": self.env.mdp.context.control_step,
        }

    def close(self) -> None:
        """Close the environment."""
        self.env.close()


@contextlib.contextmanager
def deterministic(threads: int = 1) -> Iterator[None]:
    """Use mean actions, no gradients, and matrix products of full precision, for a ``with`` block.

    The rounding of a matrix product depends on torch's number of threads. Physics, which takes nearly all the time,
    does not depend on its number of threads and keeps it.

    Args:
        threads: Torch's number of threads.
    """
    with (
        torch.no_grad(),
        set_exploration_type(ExplorationType.DETERMINISTIC),
        full_precision(),
        torch_threads(threads),
    ):
        yield
