"""Settings of a curriculum."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from skatemount.utils.classes import ClassRegistry
from skatemount.utils.errors import ConfigError

CURRICULA = ClassRegistry(
    "curriculum",
    {"auto": "skatemount.curriculum.auto:AutoCurriculum"},
    methods=("sample_poses", "observe_step", "update", "metrics", "draw", "state_dict", "load_state_dict"),
    base="skatemount.curriculum.base.Curriculum",
    reserved=("none", "stages"),
)
"""Curricula of initial states by ``curriculum.kind``."""


@dataclass
class StageLink:
    """One stage in a chain of stages.

    Attributes:
        gate: Success rate of the training's evaluations at which the stage ends; null for no gate.
        budget: Share of the frames, relative to the other stages. Frames that a stage does not use go to the later
            stages.
        renormalize: Collect new normalization statistics, as in `StageConfig`. For a stage whose observations vary far
            less than those of the stage before.
    """

    gate: float | None = None
    budget: float = 1.0
    renormalize: bool = False


@dataclass
class CurriculumConfig:
    """Settings of a curriculum of initial states.

    The automatic curriculum keeps a grid of bins over the distance and direction from the board, the heading, the
    height of the step, and whether the board is fixed or free. A bin opens when a neighboring bin is solved.

    Attributes:
        kind: ``none`` (the stage's start ranges throughout), ``stages`` (several stages, one after the other),
            ``auto``, the name of a plugin's, or ``module:Class`` of your own `Curriculum`.
        name: Name of a chain of stages.
        stages: The stages of a chain, in order.
        params: Settings of your own curriculum.
        distances: Upper edges of the rings around the board, by the horizontal distance between trunk and deck's
            center, m.
        bearings: Upper edges of the direction from the deck's center to the trunk, degrees off the board's long axis.
            At most 90, because the board is symmetric.
        headings: Upper edges of the heading's error modulo a half turn, degrees. At most 90.
        heights: Upper edges of the step up to the deck, m. The last bin is always the board's own height.
        min_height: Lower edge of the first height bin, m.
        free_board_after: Distance whose ring must be solved with the fixed board at full height before free boards are
            practiced, m; null for fixed boards only.
        success_threshold: An episode counts as a success if its `EpisodeState.soft_success` exceeds this at the time
            limit. This is easier than real success, which exploration noise hides.
        solved_rate: Share of a bin's recent episodes that must succeed for the bin to be solved.
        window: Number of recent episodes in a bin's estimate.
        min_episodes: Number of episodes that a bin needs before it counts as solved.
        replay_fraction: Share of the starts drawn uniformly from all open bins; the others are drawn where success is
            neither rare nor certain.
        stage_range_fraction: Share of the starts drawn from the stage's own ranges once every bin is open.
        stage_range_from: Distance beyond which the stage's own ranges replace the bins, m; null to keep all bins.
        stuck_start_fraction: Share of the starts in the stage's own ranges that are replaced by states of earlier
            episodes in which a robot was stuck: half-mounted more than two seconds after the first contact. Works with
            every kind except ``stages``.
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
        """Raise `ConfigError` if a setting cannot be used."""
        CURRICULA.check_name(self.kind, f"{where}.kind")
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
