"""The automatic reverse curriculum: a grid of bins of initial states that opens outward from the goal.

Follows Florensa et al., "Reverse Curriculum Generation for Reinforcement Learning" (2017): practice where success is
neither rare nor certain, keep practicing what is solved, and expand outward from there. Bins replace the paper's
sampled states, so that the estimate of success can be plotted.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from skatemount.curriculum.config import CurriculumConfig
from skatemount.curriculum.heatmap import draw_heat_map
from skatemount.envs.mdp import StepResult
from skatemount.envs.sampling import uniform
from skatemount.envs.starts import StartPoses
from skatemount.envs.state import EpisodeState
from skatemount.utils.errors import ConfigError

AXES = ("distance", "bearing", "heading", "height", "free")


class AutoCurriculum:
    """A curriculum that samples initial states from a grid of bins, and opens bins next to solved ones.

    Bins are the flattened grid ``[distance, bearing, heading, height, free]`` (`AXES`).

    Args:
        config: The grid and the thresholds.
        deck_height: Height of the board's deck at rest, m.

    Attributes:
        shape: Number of bins along each axis.
        episodes: ``[bins]`` number of recent episodes.
        successes: ``[bins]`` number of recent soft successes.
        opened: ``[bins]`` bool.
    """

    def __init__(self, config: CurriculumConfig, deck_height: float):
        config.validate()
        if max(config.heights[:-1], default=0.0) > deck_height:
            raise ConfigError(
                f"curriculum.heights={config.heights}: all but the last must be at most the deck's height, "
                f"{deck_height:g} m (the last bin is always the board's own height)"
            )
        self.config = config
        self._deck_height = deck_height
        edges = (config.distances, config.bearings, config.headings, config.heights)
        self.shape = (*map(len, edges), 1 if config.free_board_after is None else 2)
        bins = math.prod(self.shape)
        self.episodes, self.successes = torch.zeros(2, bins)
        self.opened = torch.zeros(bins, dtype=torch.bool)
        self.opened.view(self.shape)[0, :, 0, 0, 0] = True

    def sample_poses(self, n: int, generator: torch.Generator) -> StartPoses:
        """Draw bins by their weights, and a pose within each.

        Args:
            n: Number of poses.
            generator: Source of randomness.

        Returns:
            ``[n]`` poses.
        """
        bins = torch.multinomial(self.weights(), n, replacement=True, generator=generator)
        ring, bearing, heading, height, free = torch.unravel_index(bins, self.shape)

        def within(edges: list[float], index: Tensor, lowest: float = 0.0) -> Tensor:
            bounds = torch.tensor([lowest, *edges], device=index.device)
            return bounds[index] + (bounds[index + 1] - bounds[index]) * uniform((n,), generator)

        def sign() -> Tensor:
            return 1 - 2.0 * torch.randint(2, (n,), generator=generator, device=generator.device)

        c = self.config
        reach, direction = within(c.distances, ring), torch.deg2rad(within(c.bearings, bearing))
        xy = torch.stack((reach * direction.cos() * sign(), reach * direction.sin() * sign()), 1)

        # A board has no front, so half of the robots face the other way.
        yaw = torch.deg2rad(within(c.headings, heading)) * sign() + math.pi * (sign() > 0)
        step = within(c.heights, height, c.min_height)
        step = torch.where(height == len(c.heights) - 1, self._deck_height, step)
        from_stage_ranges = uniform((n,), generator) < c.stage_range_fraction if self._uses_stage_ranges() else None
        return StartPoses(
            xy=xy, yaw=yaw, step_height=step, board_fixed=free == 0, bin=bins, from_stage_ranges=from_stage_ranges
        )

    def rates(self) -> Tensor:
        """Return the estimated success rate of each bin, ``[bins]``; 0.5 where nothing is known."""
        return (self.successes + 1) / (self.episodes + 2)

    def weights(self) -> Tensor:
        """Return the probability that a start is drawn from each bin, ``[bins]``."""
        rate, useful = self.rates(), self.opened & ~self._outgrown()
        if self._uses_stage_ranges() and self.config.stage_range_from is not None:
            inside = torch.tensor(self.config.distances, device=useful.device) <= self.config.stage_range_from
            useful = (useful.view(self.shape) & inside.view(-1, 1, 1, 1, 1)).flatten()
        # Unsolved open bins get full weight. Solved bins keep a weight by the variance of success, but only at the
        # board's own height, and fixed-board bins only until the same bin with a free board is solved.
        solved_weight = (4 * rate * (1 - rate)).view(self.shape).clone()
        solved_weight[..., :-1, :] = 0.0
        if self.config.free_board_after is not None:
            solved_weight[..., 0].masked_fill_(self.solved().view(self.shape)[..., 1], 0.0)
        learning = torch.where(self.solved(), solved_weight.flatten().clamp(min=0.05), 1.0) * useful
        uniform_weight = useful.to(rate.dtype)
        replay = self.config.replay_fraction
        return (1 - replay) * learning / learning.sum() + replay * uniform_weight / uniform_weight.sum()

    def _uses_stage_ranges(self) -> bool:
        """Return True if a share of the starts is drawn from the stage's own ranges, which needs all bins open."""
        return self.config.stage_range_fraction > 0 and bool(self.opened.all())

    def _outgrown(self) -> Tensor:
        """Return the bins with a lower step whose bin at the board's own height is solved, ``[bins]`` bool."""
        grown = self.solved().view(self.shape)[..., -1:, :].expand(self.shape).clone()
        grown[..., -1, :] = False
        return grown.flatten()

    def observe_step(self, episode: EpisodeState, outcome: StepResult, done: Tensor) -> None:
        """Count the episodes that ended in a step.

        Args:
            episode: ``[N]`` episodes after the step.
            outcome: Result of the step.
            done: ``[N]`` bool, episodes that ended.
        """
        ended = (done & (episode.bin >= 0)).to(torch.float32)
        good = ended * (outcome.truncated & (episode.soft_success > self.config.success_threshold))
        # Worlds without an ended episode add 0, so shapes do not depend on the data.
        bins = episode.bin.clamp(min=0)
        self.episodes.index_add_(0, bins, ended)
        self.successes.index_add_(0, bins, good)

    def tallies(self) -> list[Tensor]:
        """Return the counts of episodes and successes, which several ranks add up; see `Curriculum.tallies`."""
        return [self.episodes, self.successes]

    def fade(self) -> None:
        """Limit the counts to the window of recent episodes."""
        fade = (self.config.window / self.episodes.clamp(min=1e-6)).clamp(max=1.0)
        self.episodes *= fade
        self.successes *= fade

    def update(self) -> None:
        """Limit the counts to the window of recent episodes, and open bins next to solved ones."""
        self.fade()
        solved = self.solved().view(self.shape)
        opened = self.opened.view(self.shape)
        for axis in range(len(AXES) - 1):
            steps = self.shape[axis] - 1
            for target, source in ((1, 0), (0, 1)):
                opened.narrow(axis, target, steps).logical_or_(solved.narrow(axis, source, steps))
        if (free_board_after := self.config.free_board_after) is None:
            return
        ring = next((i for i, d in enumerate(self.config.distances) if d >= free_board_after), -1)
        if bool(solved[ring, ..., -1, 0].any()):
            opened[..., 1] |= solved[..., 0]

    def solved(self) -> Tensor:
        """Return the bins that are solved, ``[bins]`` bool."""
        return self.opened & (self.episodes >= self.config.min_episodes) & (self.rates() >= self.config.solved_rate)

    def metrics(self) -> dict[str, float]:
        """Return the shares of open and solved bins, the solved distance, and success rates by board and distance."""
        rate, solved = self.rates().view(self.shape), self.solved().view(self.shape)
        metrics = {
            "Curriculum/bins_open": float(self.opened.sum()) / len(self.opened),
            "Curriculum/bins_solved": float(solved.sum()) / solved.numel(),
        }
        known = self.episodes.view(self.shape) >= self.config.min_episodes
        for free, name in enumerate(("fixed", "free")[: self.shape[-1]]):
            full = solved[..., -1, free].flatten(1)
            reach = max((d for d, s in zip(self.config.distances, full.any(1).tolist()) if s), default=0.0)
            metrics[f"Curriculum/frontier_{name}"] = reach
            if bool((enough := known[..., -1, free]).any()):
                metrics[f"Curriculum/success_{name}"] = float(rate[..., -1, free][enough].mean())
        for ring, distance in enumerate(self.config.distances):
            if bool((enough := known[ring, ..., -1, :]).any()):
                metrics[f"Curriculum/success_{distance:g}m"] = float(rate[ring, ..., -1, :][enough].mean())
        return metrics

    def draw(self, path: Path, title: str) -> None:
        """Draw the success rate over distance and heading, for each height and board; see `draw_heat_map`."""
        edges = {"distance": self.config.distances, "heading": self.config.headings, "height": self.config.heights}
        draw_heat_map(
            path,
            title,
            AXES,
            rates=self.rates().view(self.shape),
            opened=self.opened.view(self.shape),
            solved=self.solved().view(self.shape),
            resting=(self.weights() == 0).view(self.shape),
            edges=edges,
        )

    def state_dict(self) -> dict[str, Any]:
        """Return the state for a checkpoint."""
        # Saved runs have the name "trials".
        return {"trials": self.episodes, "successes": self.successes, "opened": self.opened}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restore a state that `state_dict` returned."""
        for name, value in self.state_dict().items():
            value.copy_(state[name])
