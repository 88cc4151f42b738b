"""A training whose parts can be timed one by one, all on states of the same kind."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from tensordict import TensorDictBase

from skatemount.training.trainer import Trainer
from skatemount.utils.devices import seconds

SETTLE = 50
"""Control steps until the worlds are at different times of their episodes, as they are during a training."""
KEPT = 8
"""Number of states that raw physics starts from."""

Timed = Callable[[float], tuple[int, float]]
"""A function that works for at least so many seconds, and returns environment steps and the seconds that they took."""


class BenchWorkload:
    """The work to be timed: raw physics, the environment, and the whole training.

    Args:
        trainer: The training. It keeps learning while it is timed.
    """

    def __init__(self, trainer: Trainer):
        self.trainer = trainer
        self._env = trainer.env
        self._iterations = trainer.iterations()
        # The first iteration takes longer. It also creates the collector, which resets the worlds: later, it would put
        # all of them at the start of an episode.
        next(self._iterations)
        self._env.set_seed(trainer.config.seed)
        self._data: TensorDictBase = self._env.reset()
        for _ in range(SETTLE):
            self._act()
            self._step()

    def _act(self) -> None:
        with torch.no_grad():
            self._data = self.trainer.networks.actor(self._data)

    def _step(self) -> None:
        _, self._data = self._env.step_and_maybe_reset(self._data)

    def _present_states(self) -> list[tuple[Any, torch.Tensor]]:
        """Return the engine's states of the next control steps, and the joint targets in them."""
        states = []
        for _ in range(KEPT):
            self._act()
            states.append((self._env.physics.raw_state(), self._env.mdp.targets(self._data["action"])))
            self._step()
        return states

    def raw(self, seconds: float) -> tuple[int, float]:
        """Time physics alone, on the policy's present states and actions: no resets, no observation, no reward.

        States from the start of a training would give other numbers: the cost of a step depends on the contacts.
        """
        physics, substeps, states = self._env.physics, self.trainer.config.physics.substeps, self._present_states()
        here, spent, steps = physics.raw_state(), 0.0, 0
        while spent < seconds:
            state, targets = states[steps % KEPT]
            physics.set_raw_state(state)
            start = self._now()
            physics.step(targets, substeps)
            spent += self._now() - start
            steps += 1
        physics.set_raw_state(here)
        return steps * self._env.num_worlds, spent

    def env(self, seconds: float) -> tuple[int, float]:
        """Time the environment with its resets, under the policy's actions; the policy itself is not timed."""
        spent, steps = 0.0, 0
        while spent < seconds:
            self._act()
            start = self._now()
            self._step()
            spent += self._now() - start
            steps += 1
        return steps * self._env.num_worlds, spent

    def training(self, seconds: float) -> dict[str, tuple[int, float]]:
        """Time whole iterations: ``collect``, ``learn``, and ``train``, which is both and everything between them."""
        spent = {"collect": 0.0, "learn": 0.0, "train": 0.0}
        before, start = self.trainer.frames, self._now()
        while (spent["train"] < seconds) or self.trainer.frames == before:
            metrics = next(self._iterations)
            spent["collect"] += metrics["Perf/collection_time"]
            spent["learn"] += metrics["Perf/learning_time"]
            spent["train"] = self._now() - start
        steps = self.trainer.frames - before
        return {name: (steps, took) for name, took in spent.items()}

    def _now(self) -> float:
        return seconds(self._env.physics.device)

    def close(self) -> None:
        """Stop everything."""
        self._iterations.close()
        self.trainer.close()
