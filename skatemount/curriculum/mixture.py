"""A mixture of initial states from the goal outward, without a curriculum."""

from __future__ import annotations

import torch
from torch import Tensor

from skatemount.curriculum.auto import AutoCurriculum
from skatemount.curriculum.config import CurriculumConfig


class MixtureCurriculum(AutoCurriculum):
    """All bins of the automatic curriculum's grid from the first iteration, each drawn as often as the others.

    A share of the starts comes from the stage's own ranges, as in the automatic curriculum once all bins are open. The
    idea that a mixture of initial states can replace a curriculum follows "OmniReset" (2026, arXiv:2603.15789).

    Args:
        config: The grid; ``free_board_after`` only says whether there are free boards.
        deck_height: Height of the board's deck at rest, m.
    """

    def __init__(self, config: CurriculumConfig, deck_height: float):
        super().__init__(config, deck_height)
        self.opened[:] = True

    def weights(self) -> Tensor:
        """Return the probability that a start is drawn from each bin, ``[bins]``."""
        return torch.full_like(self.episodes, 1 / len(self.episodes))

    def update(self) -> None:
        """Limit the counts to the window of recent episodes."""
        self.fade()
