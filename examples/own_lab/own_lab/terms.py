"""Terms of the lab; `plugins=[own_lab.terms]` registers them."""

from __future__ import annotations

import torch
from torch import Tensor

from skatemount.envs.observations import observation
from skatemount.envs.rewards import reward
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.terminations import termination
from skatemount.envs.terms import TaskContext


@reward
def near_center(sim: SimState, episode: EpisodeState, context: TaskContext, scale: float = 0.2) -> Tensor:
    """Reward a trunk above the deck's center: exp(-distance / scale), ``[N]``.

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        scale: Horizontal distance at which the value falls to 1/e, m.
    """
    return torch.exp(-episode.distance / scale)


@observation(1, "scalars")
def trunk_height(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the height of the trunk's center above the stance, ``[N, 1]`` m."""
    return sim.base_pos[:, 2:] - context.stance_height


@termination
def fallen(sim: SimState, episode: EpisodeState, context: TaskContext, meters: float = 0.12) -> Tensor:
    """End the episode when the trunk is too low.

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        meters: Smallest height of the trunk's center, m.
    """
    return sim.base_pos[:, 2] < meters
