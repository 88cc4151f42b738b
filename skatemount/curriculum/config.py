"""Settings of a curriculum."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from skatemount.utils.bounds import check_bounds, each, number
from skatemount.utils.classes import ClassRegistry
from skatemount.utils.errors import ConfigError

CURRICULA = ClassRegistry(
    "curriculum",
    {
        "auto": "skatemount.curriculum.auto:AutoCurriculum",
        "mixture": "skatemount.curriculum.mixture:MixtureCurriculum",
    },
    methods=("sample_poses", "observe_step", "update", "metrics", "draw", "state_dict", "load_state_dict"),
    base="skatemount.curriculum.base.Curriculum",
    reserved=("none", "stages"),
)
"""Curricula of initial states by ``curriculum.kind``."""

MAX_EDGES = 100
"""Largest number of bins along one axis."""


@dataclass
class StageLink:
    """One stage in a chain of stages.

    Attributes:
        gate: Success rate of the training's evaluations at which the stage ends; null for no gate.
        budget: Share of the frames, relative to the other stages. Frames that a stage does not use go to the later
            stages.
        renormalize: Collect new normalization statistics, as in `StageConfig`. For a stage whose observations vary far
            less than those of the stage before.
        settings: Settings of this stage alone, as on the command line, such as ``curriculum=auto``. Without one of the
            curriculum, the stage has none.
    """

    gate: float | None = field(default=None, metadata=number(0, 1, above=True))
    budget: float = field(default=1.0, metadata=number(0, 1e9, above=True))
    renormalize: bool = False
    settings: list[str] = field(default_factory=list)


@dataclass
class CurriculumConfig:
    """Settings of a curriculum of initial states.

    The automatic curriculum keeps a grid of bins over the distance and direction from the board, the heading, the
    height of the step, and whether the board is fixed or free. A bin opens when a neighboring bin is solved.

    Attributes:
        kind: ``none`` (the stage's start ranges throughout), ``stages`` (several stages, one after the other),
            ``auto``, ``mixture``, the name of a plugin's, or ``module:Class`` of your own `Curriculum`.
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
    distances: list[float] = field(metadata=each(0, 100, "m", above=True))
    bearings: list[float] = field(metadata=each(0, 90, "degrees, because a board has no front", above=True))
    headings: list[float] = field(metadata=each(0, 90, "degrees, because a board has no front", above=True))
    heights: list[float] = field(metadata=each(0, 1, "m", above=True))
    min_height: float = field(metadata=number(0, 1, "m", above=True))
    free_board_after: float | None = field(metadata=number(0, 100, "m"))
    success_threshold: float = field(metadata=number(0, 1, above=True, below=True))
    solved_rate: float = field(metadata=number(0, 1, above=True, below=True))
    window: float = field(metadata=number(0, 1e6, above=True))
    min_episodes: float = field(metadata=number(0, 1e6, above=True))
    replay_fraction: float = field(metadata=number(0, 1, above=True, below=True))
    stage_range_fraction: float = field(metadata=number(0, 1))
    stage_range_from: float | None = field(metadata=number(0, 100, "m", above=True))
    stuck_start_fraction: float = field(metadata=number(0, 1, below=True))

    def validate(self, where: str = "curriculum") -> None:
        """Raise `ConfigError` if a setting cannot be used."""
        CURRICULA.check_name(self.kind, f"{where}.kind")
        check_bounds(self, where)
        self._validate_stages(where)
        for name in ("distances", "bearings", "headings", "heights"):
            edges = getattr(self, name)
            if not edges or edges != sorted(set(edges)):
                raise ConfigError(f"{where}.{name}={edges} must be increasing numbers above 0")
            if len(edges) > MAX_EDGES:
                raise ConfigError(f"{where}.{name} has {len(edges)} numbers; at most {MAX_EDGES} are possible")
        if not 0 < self.min_height < self.heights[0]:
            raise ConfigError(
                f"{where}.min_height={self.min_height} must be above 0 and below heights[0]={self.heights[0]}"
            )
        if self.stage_range_from is not None and not self.stage_range_from >= self.distances[0]:
            raise ConfigError(
                f"{where}.stage_range_from={self.stage_range_from} must be null, or at least "
                f"distances[0]={self.distances[0]} m: "
                "some bins must be left"
            )
        if self.stuck_start_fraction and self.kind == "stages":
            raise ConfigError(
                f"{where}.stuck_start_fraction={self.stuck_start_fraction} must be 0 in a chain of stages"
            )
        if not self.min_episodes <= self.window:
            raise ConfigError(f"{where}.min_episodes={self.min_episodes} must be at most window={self.window}")

    def _validate_stages(self, where: str) -> None:
        if self.kind == "stages" and not (self.stages and self.name):
            raise ConfigError(f"{where}.kind=stages needs {where}.stages and {where}.name: choose +curriculum=paper")
        for name, link in self.stages.items():
            check_bounds(link, f"{where}.stages.{name}")
