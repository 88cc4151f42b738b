"""A term of the lab that remembers something of the episode."""

from __future__ import annotations

import torch
from torch import Tensor

from skatemount.envs.memory import TermWithMemory
from skatemount.envs.rewards import penalty
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.terms import TaskContext


@penalty
class TimeInTheAir(TermWithMemory):
    """Penalize a robot that has been in the air for long: the time beyond a limit, s.

    Args:
        context: Constants of the task.
        num_worlds: Number of worlds.
        limit: Time that is free, s.
    """

    def __init__(self, context: TaskContext, num_worlds: int, limit: float = 0.2):
        self.limit = limit
        self.time = torch.zeros(num_worlds)

    def reset(self, rows: Tensor) -> None:
        """Forget the time of some worlds, ``[K]`` int64."""
        self.time.index_fill_(0, rows, 0.0)

    def __call__(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
        """Return the term, ``[N]``."""
        self.time = torch.where(episode.touching.any(1), 0.0, self.time + context.control_step)
        return (self.time - self.limit).clamp(min=0.0)
