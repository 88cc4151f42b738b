"""Settings of a curriculum, and what one has to offer."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any, Protocol

import torch
from torch import Tensor

from skatemount.curriculum.config import CURRICULA, CurriculumConfig
from skatemount.envs.mdp import StepResult
from skatemount.envs.starts import StartPoses
from skatemount.envs.state import EpisodeState
from skatemount.utils.errors import ConfigError


class Curriculum(Protocol):
    """Chooses where episodes start, and learns from how they ended.

    Made with the settings and the board's own step height, m, under ``torch.device``: what it then makes is where the
    environment is.
    """

    def sample_poses(self, n: int, generator: torch.Generator) -> StartPoses:
        """Draw ``n`` places to start at; what `StartPoses.bin` says comes back as the episode's ``bin``.

        But for the first episodes of a training, which start in the middle: theirs is -1.
        """

    def observe_step(self, episode: EpisodeState, outcome: StepResult, done: Tensor) -> None:
        """Learn from a step: the episodes ``[N]``, what the step led to, and which of them it ended."""

    def update(self) -> None:
        """Decide anew what is practised; called after every iteration, before new places are drawn."""

    def metrics(self) -> dict[str, float]:
        """Where the curriculum is, under ``Curriculum/<name>``."""

    def draw(self, path: Path, title: str) -> None:
        """Make a picture (PNG) of where the curriculum is, if it has one."""

    def state_dict(self) -> dict[str, Any]:
        """What a checkpoint needs."""

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` returned."""


def make_curriculum(
    config: CurriculumConfig, deck_height: float, device: torch.device | None = None
) -> Curriculum | None:
    """The curriculum that the settings name.

    Args:
        config: The settings.
        deck_height: The board's own step height, m.
        device: Where the environment is: the tensors that it makes as it is made are there.

    Returns:
        None if start states are the stage's own throughout.

    Raises:
        ConfigError: There is no such class.
    """
    if config.kind in ("none", "stages"):
        return None
    module, _, name = CURRICULA.get(config.kind, config.kind).partition(":")
    try:
        with device or torch.device("cpu"):
            made = getattr(importlib.import_module(module), name)(config, deck_height)
    except (ImportError, AttributeError, TypeError, ValueError) as error:
        if isinstance(error, ConfigError):
            raise
        raise ConfigError(f"curriculum.kind={config.kind}: no curriculum can be made of it ({error})") from error
    return made
