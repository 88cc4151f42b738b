"""Settings of a curriculum."""

from __future__ import annotations

from dataclasses import dataclass, field

from skatemount.errors import ConfigError

KINDS = ("none", "auto")


@dataclass
class CurriculumConfig:
    """Which start states are practised when.

    The automatic curriculum keeps a grid of bins: how far from the board, in which direction, how far the heading is
    off, how high the step is, board fixed or free. A bin opens when a neighbour is solved.

    Attributes:
        kind: ``none`` (the stage's start ranges throughout) or ``auto``.
        distances: Upper edges of the rings about the board: the trunk's distance from the deck's centre in the plane,
            m.
        bearings: Upper edges of the direction from the deck's centre to the trunk, degrees off the board's long axis,
            up to 90; the board is as symmetric as that.
        headings: Upper edges of the heading's error modulo a half turn, degrees, up to 90.
        heights: Upper edges of the step up to the deck, m; the last bin is always the board's own height.
        lowest: Lower edge of the first of the heights, m.
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
    distances: list[float] = field(default_factory=lambda: [0.06, 0.12, 0.18, 0.24, 0.32, 0.4, 0.5, 0.65, 0.8, 1.05])
    bearings: list[float] = field(default_factory=lambda: [30.0, 60.0, 90.0])
    headings: list[float] = field(default_factory=lambda: [20.0, 50.0, 90.0])
    heights: list[float] = field(default_factory=lambda: [0.02, 0.04, 0.065, 0.088])
    lowest: float = 0.008
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
        for name in ("distances", "bearings", "headings", "heights"):
            edges = getattr(self, name)
            if not edges or edges != sorted(set(edges)) or edges[0] <= 0:
                raise ConfigError(f"{where}.{name}={edges} must be increasing numbers above 0")
        for name in ("bearings", "headings"):
            if (edges := getattr(self, name))[-1] > 90:
                raise ConfigError(f"{where}.{name}={edges} must not exceed 90 degrees: a board has no front")
        if not 0 < self.lowest < self.heights[0]:
            raise ConfigError(f"{where}.lowest={self.lowest} must be above 0 and below heights[0]={self.heights[0]}")
        for name in ("steady", "solved", "replay"):
            if not 0 < getattr(self, name) < 1:
                raise ConfigError(f"{where}.{name}={getattr(self, name)} must be a share between 0 and 1")
        if not self.memory > 0:
            raise ConfigError(f"{where}.memory={self.memory} must be above 0")
        if not 0 < self.least <= self.memory:
            raise ConfigError(f"{where}.least={self.least} must be above 0 and at most memory={self.memory}")
