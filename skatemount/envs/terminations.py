"""Termination terms: conditions that end an episode before its time limit.

Every function returns ``[N]`` bool. "Paper's code" means the settings of the paper's published runs, "ours" a term that
is not in them.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from skatemount.envs import success
from skatemount.envs.config.terms import TerminationTerm
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.terms import AnyTerm, Registry, TaskContext, memory_of

TERMINATIONS = Registry("termination", flags=True)


def termination(function: AnyTerm) -> AnyTerm:
    """Register a term that returns ``[N]`` bool and ends the episodes where it is true."""
    return TERMINATIONS.register()(function)


@termination
def trunk_contact(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """End the episode when the trunk touches anything with more than 1 N (paper's code)."""
    return sim.body_force[:, 0] > success.PRESS


@termination
def tilt(sim: SimState, episode: EpisodeState, context: TaskContext, degrees: float = 66.0) -> Tensor:
    """End the episode when the trunk is tilted too far from upright (ours).

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        degrees: Largest tilt, degrees.
    """
    return -sim.gravity[:, 2] < math.cos(math.radians(degrees))


@termination
def board_tilt(sim: SimState, episode: EpisodeState, context: TaskContext, degrees: float = 53.0) -> Tensor:
    """End the episode when the deck is tilted too far from level (ours; with 90 degrees, the paper's flip).

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        degrees: Largest tilt, degrees.
    """
    return success.deck_level(sim) < math.cos(math.radians(degrees))


@termination
def out_of_reach(sim: SimState, episode: EpisodeState, context: TaskContext, metres: float = 2.2) -> Tensor:
    """End the episode when the trunk is too far from the deck's center (ours).

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        metres: Largest horizontal distance, m.
    """
    return episode.distance > metres


class TerminationTable:
    """Termination terms; an episode ends early when any of them is true.

    Args:
        terms: Settings of the terms by name.
        context: Constants of the task.

    Attributes:
        names: Names of the enabled terms, in order.
        memory: Those of the enabled terms that have a memory.

    Raises:
        ConfigError: A term or a parameter is unknown, or a parameter has a value that cannot be used.
    """

    def __init__(self, terms: dict[str, TerminationTerm], context: TaskContext):
        self._context = context
        bound = {name: TERMINATIONS.bind(name, term.params) for name, term in terms.items()}
        self.names = [name for name, term in terms.items() if term.enabled]
        self._functions = [bound[name] for name in self.names]
        self.memory = memory_of(self._functions)

    def __call__(self, sim: SimState, episode: EpisodeState) -> Tensor:
        """Evaluate the terms.

        Args:
            sim: The state after the step.
            episode: The episodes, updated by the step.

        Returns:
            ``[terms, N]`` bool.
        """
        if not self._functions:
            return sim.base_pos.new_zeros(0, sim.base_pos.shape[0], dtype=torch.bool)
        return torch.stack([f(sim, episode, self._context) for f in self._functions])
