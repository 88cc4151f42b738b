"""The automatic reverse curriculum: a grid of start bins that opens outwards from the goal.

After Florensa et al., "Reverse Curriculum Generation for Reinforcement Learning" (2017): practise where success is
neither rare nor sure, go on practising what is solved, and step outwards from there. Bins instead of sampled states
keep an estimate of success that can be looked at.
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
    """Chooses the bins that starts are drawn from, and learns from how the episodes ended.

    Bins are indexed ``[distance, bearing, heading, height, free]`` (`AXES`), flattened.

    Args:
        config: The grid and the thresholds.
        deck_height: The board's own step height, m.

    Attributes:
        episodes: ``[bins]`` recent episodes.
        successes: ``[bins]`` recent soft successes.
        opened: ``[bins]`` bool.
    """

    def __init__(self, config: CurriculumConfig, deck_height: float):
        config.validate()
        if max(config.heights[:-1], default=0.0) > deck_height:
            raise ConfigError(
                f"curriculum.heights={config.heights}: all but the last one, which stands for the board's own, must be "
                f"at most its deck's height, {deck_height:g} m"
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
        """Draw bins, and a place within each.

        Args:
            n: How many.
            generator: Source of randomness.
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

        # A board has no front: half of the starts face the other way.
        yaw = torch.deg2rad(within(c.headings, heading)) * sign() + math.pi * (sign() > 0)
        step = within(c.heights, height, c.min_height)
        step = torch.where(height == len(c.heights) - 1, self._deck_height, step)
        from_stage_ranges = uniform((n,), generator) < c.stage_range_fraction if self._uses_stage_ranges() else None
        return StartPoses(
            xy=xy, yaw=yaw, step_height=step, board_fixed=free == 0, bin=bins, from_stage_ranges=from_stage_ranges
        )

    def rates(self) -> Tensor:
        """Estimated success of each bin, ``[bins]``; a half where nothing is known."""
        return (self.successes + 1) / (self.episodes + 2)

    def weights(self) -> Tensor:
        """How often each bin is drawn, ``[bins]``, summing to 1."""
        rate, useful = self.rates(), self.opened & ~self._outgrown()
        if self._uses_stage_ranges() and self.config.stage_range_from is not None:
            inside = torch.tensor(self.config.distances, device=useful.device) <= self.config.stage_range_from
            useful = (useful.view(self.shape) & inside.view(-1, 1, 1, 1, 1)).flatten()
        # A bin that has just opened is rarely solved, and is what has to be learnt; once it is solved, a lower step
        # than the board's own has opened what it could, and so has a fixed board where the free one is solved.
        left = (4 * rate * (1 - rate)).view(self.shape).clone()
        left[..., :-1, :] = 0.0
        if self.config.free_board_after is not None:
            left[..., 0].masked_fill_(self.solved().view(self.shape)[..., 1], 0.0)
        learning = torch.where(self.solved(), left.flatten().clamp(min=0.05), 1.0) * useful
        alike = useful.to(rate.dtype)
        replay = self.config.replay_fraction
        return (1 - replay) * learning / learning.sum() + replay * alike / alike.sum()

    def _uses_stage_ranges(self) -> bool:
        """Whether a part of the starts is drawn from the stage's own ranges by now."""
        return self.config.stage_range_fraction > 0 and bool(self.opened.all())

    def _outgrown(self) -> Tensor:
        """Which bins with a lower step have nothing left to teach: the board's own height is solved there."""
        grown = self.solved().view(self.shape)[..., -1:, :].expand(self.shape).clone()
        grown[..., -1, :] = False
        return grown.flatten()

    def observe_step(self, episode: EpisodeState, outcome: StepResult, done: Tensor) -> None:
        """Learn from the episodes that ended in a step.

        Args:
            episode: The episodes.
            outcome: What the step led to.
            done: ``[N]`` bool.
        """
        ended = (done & (episode.bin >= 0)).to(torch.float32)
        good = ended * (outcome.truncated & (episode.soft_success > self.config.success_threshold))
        # Every world takes part, with 0 where no episode of a bin ended: shapes do not depend on what happened.
        bins = episode.bin.clamp(min=0)
        self.episodes.index_add_(0, bins, ended)
        self.successes.index_add_(0, bins, good)

    def update(self) -> None:
        """Forget what is long ago, and open bins next to solved ones."""
        fade = (self.config.window / self.episodes.clamp(min=1e-6)).clamp(max=1.0)
        self.episodes *= fade
        self.successes *= fade
        solved = self.solved().view(self.shape)
        opened = self.opened.view(self.shape)
        for axis in range(len(AXES) - 1):
            steps = self.shape[axis] - 1
            for onto, seen in ((1, 0), (0, 1)):
                opened.narrow(axis, onto, steps).logical_or_(solved.narrow(axis, seen, steps))
        if (free_board_after := self.config.free_board_after) is None:
            return
        ring = next((i for i, d in enumerate(self.config.distances) if d >= free_board_after), -1)
        if bool(solved[ring, ..., -1, 0].any()):
            opened[..., 1] |= solved[..., 0]

    def solved(self) -> Tensor:
        """Which bins are solved, ``[bins]`` bool."""
        return self.opened & (self.episodes >= self.config.min_episodes) & (self.rates() >= self.config.solved_rate)

    def metrics(self) -> dict[str, float]:
        """Where the curriculum is, under the field's metric names."""
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
            if bool((seen := known[..., -1, free]).any()):
                metrics[f"Curriculum/success_{name}"] = float(rate[..., -1, free][seen].mean())
        for ring, distance in enumerate(self.config.distances):
            if bool((seen := known[ring, ..., -1, :]).any()):
                metrics[f"Curriculum/success_{distance:g}m"] = float(rate[ring, ..., -1, :][seen].mean())
        return metrics

    def draw(self, path: Path, title: str) -> None:
        """Draw success over distance and heading, for each height and board; see `draw_heat_map`."""
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
        """What a checkpoint needs."""
        return {"trials": self.episodes, "successes": self.successes, "opened": self.opened}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restore what `state_dict` returned."""
        for name, value in self.state_dict().items():
            value.copy_(state[name])
