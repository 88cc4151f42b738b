"""Settings of a curriculum."""

from __future__ import annotations

from dataclasses import dataclass, field

from skatemount.errors import ConfigError

KINDS = ("none", "auto")


@dataclass
class CurriculumConfig:
    """Which start states are practised when.

    The automatic curriculum keeps a grid of bins: how far from the board, how far the heading is off, how high the
    step is, board fixed or free. A bin opens when an easier neighbour is solved.

    Attributes:
        kind: ``none`` (the stage's start ranges throughout) or ``auto``.
        distances: Upper edges of the rings about the board: largest coordinate of the trunk in the board frame, m.
        headings: Upper edges of the heading's error modulo a half turn, degrees, up to 90.
        heights: Upper edges of the step up to the deck, m, from 0.02; the last bin is always the board's own height.
        free_after: Free boards join when this ring is solved on the fixed board at full height, m.
        steady: An episode counts as a success when its `EpisodeState.steadiness` exceeds this at the time limit;
            milder than the real success, which exploration noise hides.
        solved: A bin is solved when this share of its recent episodes succeeded.
        memory: Recent episodes a bin's estimate is about.
        least: Episodes a bin needs before it counts as solved.
        replay: Share of the starts drawn from all open bins alike; the others go where success is neither rare nor
            sure.
    """

    kind: str = "none"
    distances: list[float] = field(default_factory=lambda: [0.06, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0])
    headings: list[float] = field(default_factory=lambda: [15.0, 45.0, 90.0])
    heights: list[float] = field(default_factory=lambda: [0.04, 0.06, 0.075, 0.088])
    free_after: float = 0.3
    steady: float = 0.6
    solved: float = 0.5
    memory: float = 40.0
    least: float = 15.0
    replay: float = 0.3

    def validate(self, where: str = "curriculum") -> None:
        """Raise `ConfigError` for settings that cannot be used."""
        if self.kind not in KINDS:
            raise ConfigError(f"{where}.kind={self.kind} must be one of {', '.join(KINDS)}")
        for name in ("distances", "headings", "heights"):
            edges = getattr(self, name)
            if not edges or edges != sorted(set(edges)) or edges[0] <= 0:
                raise ConfigError(f"{where}.{name}={edges} must be increasing numbers above 0")
        if self.headings[-1] > 90:
            raise ConfigError(f"{where}.headings={self.headings} must not exceed 90 degrees: a board has no front")
        for name in ("steady", "solved", "replay"):
            if not 0 < getattr(self, name) < 1:
                raise ConfigError(f"{where}.{name}={getattr(self, name)} must be a share between 0 and 1")
        if not self.memory > 0:
            raise ConfigError(f"{where}.memory={self.memory} must be above 0")
        if not 0 < self.least <= self.memory:
            raise ConfigError(f"{where}.least={self.least} must be above 0 and at most memory={self.memory}")
