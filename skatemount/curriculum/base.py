"""`Curriculum`: the protocol of a curriculum of initial states, and the function that makes one."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol

import torch
from torch import Tensor

from skatemount.curriculum.config import CURRICULA, CurriculumConfig
from skatemount.envs.mdp import StepResult
from skatemount.envs.starts import StartPoses
from skatemount.envs.state import EpisodeState
from skatemount.utils.classes import made


class Curriculum(Protocol):
    """A curriculum of initial states, which chooses the next ones by the episodes that ended.

    The constructor takes `CurriculumConfig` and the height of the board's deck, m. It runs under ``torch.device`` of
    the environment, so the tensors that it makes are on that device.
    """

    def sample_poses(self, n: int, generator: torch.Generator) -> StartPoses:
        """Draw ``n`` initial poses.

        `StartPoses.bin` comes back as the episode's ``bin``. The first episodes of a training begin at random phases
        and have bin -1.
        """

    def observe_step(self, episode: EpisodeState, outcome: StepResult, done: Tensor) -> None:
        """Take a control step into account.

        Args:
            episode: ``[N]`` episodes after the step.
            outcome: Result of the step.
            done: ``[N]`` bool, episodes that ended.
        """

    def tallies(self) -> list[Tensor]:
        """Return the tensors to which `observe_step` adds; only a training with several ranks needs them.

        What each rank has added is summed over all ranks before `update`, which must follow from these tensors alone,
        so that all ranks have the same curriculum.
        """

    def update(self) -> None:
        """Update the choice of poses; called after every batch, before it is learned from and new poses are drawn."""

    def metrics(self) -> dict[str, float]:
        """Return the progress of the curriculum, under ``Curriculum/<name>``."""

    def draw(self, path: Path, title: str) -> None:
        """Write a picture (PNG) of the curriculum's progress, or nothing."""

    def state_dict(self) -> dict[str, Any]:
        """Return the state for a checkpoint."""

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore a state that `state_dict` returned."""


def make_curriculum(
    config: CurriculumConfig, deck_height: float, device: torch.device | None = None
) -> Curriculum | None:
    """Make the curriculum that the settings name.

    Args:
        config: The settings.
        deck_height: Height of the board's deck at rest, m.
        device: Device of the environment, on which the curriculum makes its tensors; the CPU if None.

    Returns:
        The curriculum, or None if all initial states come from the stage's own ranges.

    Raises:
        ConfigError: There is no such class, or it cannot be made with these settings.
    """
    if config.kind in ("none", "stages"):
        return None
    cls = CURRICULA.find(config.kind, "curriculum.kind")
    with device or torch.device("cpu"):
        curriculum: Curriculum = made(cls, f"curriculum.kind={config.kind}", config, deck_height)
    return curriculum
