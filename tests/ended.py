"""Episodes that end in chosen bins of a curriculum."""

from __future__ import annotations

import defaults
import torch

from skatemount.curriculum.base import Curriculum
from skatemount.envs.mdp import StepResult
from skatemount.envs.state import EpisodeState


def finish(curriculum: Curriculum, bins: torch.Tensor, good: bool) -> None:
    """End one episode of each of these bins."""
    n = len(bins)
    episode = EpisodeState.zeros(n, defaults.LAYOUT)
    episode.bin = bins
    episode.soft_success = torch.full((n,), 1.0 if good else 0.0)
    flags = torch.ones(n, dtype=torch.bool)
    outcome = StepResult(torch.zeros(n), torch.zeros(0, n), torch.zeros(0, n), ~flags, flags, flags)
    curriculum.observe_step(episode, outcome, flags)
