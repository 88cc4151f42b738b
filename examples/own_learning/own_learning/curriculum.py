"""A curriculum: start close to the board, and farther away as the robot succeeds."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from skatemount.curriculum.config import CurriculumConfig
from skatemount.envs.mdp import StepResult
from skatemount.envs.starts import StartPoses
from skatemount.envs.state import EpisodeState


class Outwards:
    """Starts within a radius around the board, which grows by a tenth whenever most episodes of a batch succeed.

    ``curriculum.params``: ``nearest`` and ``farthest``, the first and the largest radius, m.
    """

    def __init__(self, config: CurriculumConfig, deck_height: float) -> None:
        self.radius, self._farthest = float(config.params["nearest"]), float(config.params["farthest"])
        self._height = deck_height
        self.ended, self.successes = torch.zeros(2)

    def sample_poses(self, n: int, generator: torch.Generator) -> StartPoses:
        """Draw poses on a disk, with the robot along the board."""
        here = generator.device
        distance, angle = torch.rand(2, n, generator=generator, device=here)
        distance, angle = self.radius * distance.sqrt(), 2 * math.pi * angle
        xy = torch.stack((distance * angle.cos(), distance * angle.sin()), 1)
        fixed = torch.ones(n, dtype=torch.bool, device=here)
        height = torch.full((n,), self._height, device=here)
        bins = torch.zeros(n, dtype=torch.long, device=here)
        return StartPoses(xy=xy, yaw=torch.zeros(n, device=here), step_height=height, board_fixed=fixed, bin=bins)

    def observe_step(self, episode: EpisodeState, outcome: StepResult, done: Tensor) -> None:
        """Count the episodes that ended; the first ones, at random phases, have bin -1."""
        counted = done & (episode.bin >= 0)
        self.ended += counted.sum()
        self.successes += (counted & outcome.succeeded).sum()

    def update(self) -> None:
        """Grow the radius if most episodes of the batch succeeded."""
        if self.ended and self.successes / self.ended > 0.7:
            self.radius = min(1.1 * self.radius, self._farthest)
        self.ended.zero_()
        self.successes.zero_()

    def metrics(self) -> dict[str, float]:
        """Return the radius."""
        return {"Curriculum/radius": self.radius}

    def draw(self, path: Path, title: str) -> None:
        """Draw nothing."""

    def state_dict(self) -> dict[str, Any]:
        """Return the radius."""
        return {"radius": self.radius}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the radius."""
        self.radius = state["radius"]
