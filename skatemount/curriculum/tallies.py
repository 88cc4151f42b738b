"""The tallies of a curriculum that several processes, or ranks, add up."""

from __future__ import annotations

from torch import Tensor

from skatemount.curriculum.base import Curriculum
from skatemount.utils.errors import ConfigError
from skatemount.utils.ranks import Ranks


class SharedTallies:
    """The tallies of a curriculum, to which each rank adds its own episodes.

    Args:
        curriculum: The curriculum; None for none.
        ranks: The processes.
        kind: The setting ``curriculum.kind``, for messages.

    Raises:
        ConfigError: There are several ranks, and the curriculum has no method ``tallies``.
    """

    def __init__(self, curriculum: Curriculum | None, ranks: Ranks, kind: str):
        self._ranks = ranks
        self._shares = curriculum is not None and ranks.size > 1
        if self._shares and not hasattr(curriculum, "tallies"):
            raise ConfigError(
                f"curriculum.kind={kind} cannot be used by {ranks.size} ranks: {type(curriculum).__name__} has no "
                "method tallies, which returns the tensors that ranks add up"
            )
        self._curriculum = curriculum
        self._before: list[Tensor] = []

    def mark(self) -> None:
        """Note that all ranks have the same tallies now."""
        if self._shares:
            assert self._curriculum is not None
            self._before = [each.clone() for each in self._curriculum.tallies()]

    def share(self) -> None:
        """Give each rank what any rank has added since `mark`."""
        if not self._shares:
            return
        assert self._curriculum is not None
        tallies = self._curriculum.tallies()
        added = [now - before for now, before in zip(tallies, self._before)]
        self._ranks.sum(*added)
        for tally, before, more in zip(tallies, self._before, added):
            tally.copy_(before + more)
