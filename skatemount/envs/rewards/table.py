"""The reward table: terms with their weights."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from skatemount.envs.config.terms import RewardTerm
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.terms import AnyTerm, Registry, TaskContext, memory_of, upright
from skatemount.utils.errors import ConfigError


@dataclass(frozen=True)
class RewardKind:
    """The sign of a reward term, and the unit of its weight.

    Attributes:
        sign: 1 for a reward, -1 for a penalty.
        event: True if the weight counts for each occurrence, False if it counts per second.
    """

    sign: int
    event: bool = False


REWARDS = Registry("reward")


def reward(function: AnyTerm) -> AnyTerm:
    """Register a term that is added, with a weight per second."""
    return REWARDS.register(RewardKind(1))(function)


def penalty(function: AnyTerm) -> AnyTerm:
    """Register a term that is subtracted, with a weight per second."""
    return REWARDS.register(RewardKind(-1))(function)


def event_penalty(function: AnyTerm) -> AnyTerm:
    """Register a term that is subtracted, with a weight for each occurrence."""
    return REWARDS.register(RewardKind(-1, event=True))(function)


class RewardTable:
    """Reward terms with their weights.

    Args:
        terms: Settings of the terms by name; terms of weight 0 are left out.
        context: Constants of the task.
        where: Name of the table in the configuration, for messages.

    Attributes:
        names: Names of the terms, in order.
        memory: Those of the terms that have a memory.

    Raises:
        ConfigError: A term is unknown, or a setting has a value that cannot be used.
    """

    def __init__(self, terms: dict[str, RewardTerm], context: TaskContext, where: str = "reward"):
        self._context = context
        rows = []
        for name, term in terms.items():
            function = REWARDS.bind(name, term.params, where)
            if not (math.isfinite(term.weight) and term.weight >= 0):
                known: RewardKind = REWARDS.attributes(name)
                role = "added" if known.sign > 0 else "subtracted"
                raise ConfigError(
                    f"{where}.{name}.weight={term.weight} must be 0 or more; the term is always {role}, "
                    f"so give the size (such as {abs(term.weight) if math.isfinite(term.weight) else 1.0})"
                )
            if term.clip is not None and not term.clip > 0:
                raise ConfigError(f"{where}.{name}.clip={term.clip} must be above 0, or null for none")
            if term.weight > 0:
                rows.append((name, term, function, REWARDS.attributes(name)))
        self.names = [name for name, *_ in rows]
        self._functions = [function for _, _, function, _ in rows]
        self.memory = memory_of(self._functions)
        self._gated = [term.upright for _, term, _, _ in rows]
        step = context.control_step
        weights = [k.sign * t.weight * (1.0 if k.event else step) for _, t, _, k in rows]
        clips = [math.inf if t.clip is None else t.clip for _, t, _, _ in rows]
        self._weights = torch.tensor(weights).unsqueeze(1)
        self._clips = torch.tensor(clips).unsqueeze(1)

    def __call__(self, sim: SimState, episode: EpisodeState) -> Tensor:
        """Compute the weighted terms of a step.

        Args:
            sim: The state after the step.
            episode: The episodes, updated by the step and its terminations.

        Returns:
            ``[terms, N]``; the reward is the sum over terms.
        """
        n = sim.base_pos.shape[0]
        if not self._functions:
            return sim.base_pos.new_zeros(0, n)
        factor = upright(sim)
        values = []
        for function, gated in zip(self._functions, self._gated):
            value = function(sim, episode, self._context)
            values.append(value * factor if gated else value)
        return torch.minimum(torch.stack(values), self._clips) * self._weights
