"""Settings of a curriculum."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from skatemount.utils.errors import ConfigError

CURRICULA = {"auto": "skatemount.curriculum.auto:AutoCurriculum"}
"""Curricula of start states by their kind: ``module:Class``. A kind that is not here names its class itself."""


KINDS = ("none", "stages", *CURRICULA)


@dataclass
class StageLink:
    """One stage in a chain of stages.

    Attributes:
        gate: Deterministic success in the training's evaluations that ends the stage; none if null.
        budget: Share of the frames. A stage gets its part of all that is left, by the shares of the stages still to
            come, so what one leaves over goes to the later ones.
        renormalize: As in `StageConfig`: for a stage that sees far less varied observations than the
            one before, whose deviations would hide them.
    """

    gate: float | None = None
    budget: float = 1.0
    renormalize: bool = False


@dataclass
class CurriculumConfig:
    """Which start states are practised when.

    The automatic curriculum keeps a grid of bins: how far from the board, in which direction, how far the heading is
    off, how high the step is, board fixed or free. A bin opens when a neighbour is solved.

    Attributes:
        kind: ``none`` (the stage's start ranges throughout), ``stages`` (several stages, one after the other),
            ``auto``, or a `Curriculum` of one's own as ``module:Class``.
        name: What a chain of stages is called.
        stages: The stages of a chain, in order.
        params: Settings of a curriculum of one's own.
        distances: Upper edges of the rings about the board: the trunk's distance from the deck's centre in the plane,
            m.
        bearings: Upper edges of the direction from the deck's centre to the trunk, degrees off the board's long axis,
            up to 90; the board is as symmetric as that.
        headings: Upper edges of the heading's error modulo a half turn, degrees, up to 90.
        heights: Upper edges of the step up to the deck, m; the last bin is always the board's own height.
        min_height: Lower edge of the first of the heights, m.
        free_board_after: Free boards join when this ring is solved on the fixed board at full height, m; null for fixed
            boards alone.
        success_threshold: An episode counts as a success when its `EpisodeState.soft_success` exceeds this at the time
            limit; milder than the real success, which exploration noise hides.
        solved_rate: A bin is solved when this share of its recent episodes succeeded.
        window: Recent episodes a bin's estimate is about.
        min_episodes: Episodes a bin needs before it counts as solved.
        replay_fraction: Share of the starts drawn from all open bins alike; the others go where success is neither
            rare nor sure.
        stage_range_fraction: Share of the starts that are drawn from the stage's own ranges once every bin is open.
        stage_range_from: With them, bins farther out than this are left to them, m; none if null.
        stuck_start_fraction: Share of the starts in the stage's own ranges that are instead states of earlier episodes
            in which a robot was stuck: half-mounted more than two seconds after the first contact. With any kind but
            ``stages``.
    """

    kind: str
    name: str
    stages: dict[str, StageLink]
    params: dict[str, Any]
    distances: list[float]
    bearings: list[float]
    headings: list[float]
    heights: list[float]
    min_height: float
    free_board_after: float | None
    success_threshold: float
    solved_rate: float
    window: float
    min_episodes: float
    replay_fraction: float
    stage_range_fraction: float
    stage_range_from: float | None
    stuck_start_fraction: float

    def validate(self, where: str = "curriculum") -> None:
        """Raise `ConfigError` for settings that cannot be used."""
        if self.kind not in KINDS and ":" not in self.kind:
            raise ConfigError(
                f"{where}.kind={self.kind} must be one of {', '.join(KINDS)}, or module:Class for one of your own"
            )
        self._validate_stages(where)
        for name in ("distances", "bearings", "headings", "heights"):
            edges = getattr(self, name)
            if not edges or edges != sorted(set(edges)) or edges[0] <= 0:
                raise ConfigError(f"{where}.{name}={edges} must be increasing numbers above 0")
        for name in ("bearings", "headings"):
            if (edges := getattr(self, name))[-1] > 90:
                raise ConfigError(f"{where}.{name}={edges} must not exceed 90 degrees: a board has no front")
        if not 0 < self.min_height < self.heights[0]:
            raise ConfigError(
                f"{where}.min_height={self.min_height} must be above 0 and below heights[0]={self.heights[0]}"
            )
        for name in ("success_threshold", "solved_rate", "replay_fraction"):
            if not 0 < getattr(self, name) < 1:
                raise ConfigError(f"{where}.{name}={getattr(self, name)} must be a share between 0 and 1")
        if not 0 <= self.stage_range_fraction <= 1:
            raise ConfigError(
                f"{where}.stage_range_fraction={self.stage_range_fraction} must be a share between 0 and 1"
            )
        if self.stage_range_from is not None and not self.stage_range_from >= self.distances[0]:
            raise ConfigError(
                f"{where}.stage_range_from={self.stage_range_from} must be null, or at least "
                f"distances[0]={self.distances[0]} m: "
                "some bins must be left"
            )
        if not 0 <= self.stuck_start_fraction < 1:
            raise ConfigError(
                f"{where}.stuck_start_fraction={self.stuck_start_fraction} must be a share, 0 or more and below 1"
            )
        if self.stuck_start_fraction and self.kind == "stages":
            raise ConfigError(
                f"{where}.stuck_start_fraction={self.stuck_start_fraction} must be 0 in a chain of stages"
            )
        if not self.window > 0:
            raise ConfigError(f"{where}.window={self.window} must be above 0")
        if not 0 < self.min_episodes <= self.window:
            raise ConfigError(
                f"{where}.min_episodes={self.min_episodes} must be above 0 and at most window={self.window}"
            )

    def _validate_stages(self, where: str) -> None:
        if self.kind == "stages" and not (self.stages and self.name):
            raise ConfigError(f"{where}.kind=stages needs {where}.stages and {where}.name: choose +curriculum=paper")
        for name, link in self.stages.items():
            if not 0 < link.budget <= 1e9:
                raise ConfigError(f"{where}.stages.{name}.budget={link.budget} must be a share above 0")
