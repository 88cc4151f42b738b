"""Settings of the programs other than training, as dataclasses; each refuses what does not concern it."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from skatemount.config.bench import BenchConfig
from skatemount.config.film import MAX_EPISODE, MAX_TOGETHER, FilmConfig, check_episodes
from skatemount.config.report import PageConfig
from skatemount.config.schema import MAX_SEED, TrainConfig, check_root
from skatemount.config.search import SearchConfig
from skatemount.config.suite import SuiteConfig
from skatemount.envs.config.task import TaskConfig
from skatemount.utils.bounds import number
from skatemount.utils.errors import ConfigError

MAX_WORLDS = 256
"""Most worlds of `python -m skatemount.play`."""

AGENTS = ("trained", "zero", "random")
VIEWERS = ("auto", "page", "native")
FORMATS = ("onnx", "torch")
"""Formats of an export."""


@dataclass
class RunsConfig:
    """Place of the runs.

    Attributes:
        root: Folder of all runs.
    """

    root: str


@dataclass
class PolicyConfig(TaskConfig):
    """Settings that `EvaluateConfig`, `RecordConfig` and `PlayConfig` share: a policy and the task to try it in.

    Settings of the task count only where the user gives them: the task is the suite's, or that of the policy's
    training (`skatemount.evaluation.suite_task.evaluation_config`).

    Attributes:
        checkpoint: Policy: ``latest``, ``best``, a run, a checkpoint, a file, or ``pretrained:NAME``.
        pipeline: Two policies in turn instead, ``WALK+MOUNT``.
        switch_distance: Distance from the board at which the second policy takes over, m.
        suite: Test to try it in; null for the task of its training.
        seed: Seed of worlds and start states.
        torch_threads: Torch's threads; 0 takes every core. Another number rounds the policy's actions differently.
        logger: Place of the runs.
    """

    checkpoint: str
    pipeline: str | None
    switch_distance: float = field(metadata=number(0, 100, "m", above=True))
    suite: SuiteConfig | None
    seed: int = field(metadata=number(0, MAX_SEED))
    torch_threads: int = field(metadata=number(1, 1024, zero="every core"))
    logger: RunsConfig

    def validate(self) -> None:
        """Raise `ConfigError` for the first setting that cannot be used."""
        super().validate()
        check_root(self.logger.root, "logger")
        if self.suite is not None:
            self.suite.validate("suite")


@dataclass
class EvaluateConfig(PolicyConfig):
    """Settings of `python -m skatemount.evaluate`; ``conf/evaluate.yaml`` has the defaults.

    Attributes:
        episodes: Episodes of each suite.
        json: File for the results.
        output: Folder for the results and success maps.
    """

    episodes: int = field(metadata=number(1, 10**6))
    json: str | None
    output: str | None


@dataclass
class RecordConfig(PolicyConfig):
    """Settings of `python -m skatemount.record`; ``conf/record.yaml`` has the defaults.

    Attributes:
        episode: Number of the episode to film, as the evaluation counts; null films the first success.
        episodes: Several episodes in one film: a number films the first ones, a list names them, and ``failed`` films
            failures; null films one.
        searched: Episodes, from number 0 on, among which the first success and the failures are looked for.
        failures: Failures that ``episodes=failed`` films, at most.
        film: Size, camera and speed of the film.
        output: Folder for the film.
    """

    episode: int | None = field(metadata=number(0, MAX_EPISODE))
    episodes: Any
    searched: int = field(metadata=number(1, 10**6))
    failures: int = field(metadata=number(1, MAX_TOGETHER))
    film: FilmConfig
    output: str | None

    def validate(self) -> None:
        """Raise `ConfigError` for the first setting that cannot be used."""
        super().validate()
        check_episodes(self.episodes, self.episode)
        self.film.validate("film")


@dataclass
class PlayConfig(PolicyConfig):
    """Settings of `python -m skatemount.play`; ``conf/play.yaml`` has the defaults.

    Attributes:
        run: Run whose newest checkpoint acts first, instead of ``checkpoint``: ``latest`` or a folder.
        watch: Take each new checkpoint of the run, and show its curves and curriculum.
        agent: Policy that acts first, one of `AGENTS`; ``zero`` and ``random`` act in the task of the trained policy.
        worlds: Number of worlds, which stand in a grid.
        speed: Seconds of the simulation in a second.
        viewer: One of `VIEWERS`: ``page`` in a browser, MuJoCo's ``native`` window, or ``auto``: the page if it is
            installed.
        host: Address that the page listens on.
        port: Its port; a busy one is replaced by the next free one.
        open_browser: Open the page in the default browser, where there is a display.
        plain: Draw the page without shadows and reflections, which are slow in a browser without a GPU.
    """

    run: str | None
    watch: bool
    agent: str
    worlds: int = field(metadata=number(1, MAX_WORLDS))
    speed: float = field(metadata=number(1 / 16, 4, why="0.5 plays at half speed"))
    viewer: str
    host: str
    port: int = field(metadata=number(1, 65535))
    open_browser: bool
    plain: bool

    def validate(self) -> None:
        """Raise `ConfigError` for the first setting that cannot be used."""
        super().validate()
        for name, known in (("agent", AGENTS), ("viewer", VIEWERS)):
            if (value := getattr(self, name)) not in known:
                raise ConfigError(f"{name}={value} must be one of {', '.join(known)}")
        if self.suite is not None and self.suite.members:
            raise ConfigError(f"suite={self.suite.name}: name one to play in, of {', '.join(self.suite.members)}")
        if self.run is not None and self.pipeline is not None:
            raise ConfigError(f"run={self.run} with pipeline={self.pipeline}: leave out one of the two")
        if self.watch and self.run is None:
            raise ConfigError("watch=true needs the run to follow, such as run=latest")
        if self.watch and self.viewer == "native":
            raise ConfigError("watch=true shows curves, which viewer=native cannot; leave out one of the two")


@dataclass
class ExportConfig(PolicyConfig):
    """Settings of `python -m skatemount.export`; ``conf/export.yaml`` has the defaults.

    Attributes:
        format: ``onnx`` for a folder that `python -m skatemount.runner` reads, ``torch`` for a program of
            ``torch.export``.
        episodes: Start states of each suite; 0 for none.
        output: Folder; null for ``exported/<name of the policy>``.
    """

    format: str
    episodes: int = field(metadata=number(1, 100_000, zero="none"))
    output: str | None

    def validate(self) -> None:
        """Raise `ConfigError` for the first setting that cannot be used."""
        super().validate()
        if self.format not in FORMATS:
            raise ConfigError(f"format={self.format} must be {' or '.join(FORMATS)}")
        if self.pipeline is not None:
            raise ConfigError(f"pipeline={self.pipeline}: export one policy at a time, with checkpoint=")


@dataclass
class BenchProgramConfig(TrainConfig):
    """Settings of `python -m skatemount.bench`; ``conf/bench.yaml`` has the defaults.

    Attributes:
        bench: Measurements to take.
        json: File for the figures.
        output: Folder for the picture.
    """

    bench: BenchConfig
    json: str | None
    output: str | None

    def validate(self) -> None:
        """Raise `ConfigError` for the first setting that cannot be used."""
        super().validate()
        self.bench.validate("bench")

    @property
    def training(self) -> TrainConfig:
        """The settings of the training that is measured."""
        return TrainConfig(**{field.name: getattr(self, field.name) for field in dataclasses.fields(TrainConfig)})


@dataclass
class SearchProgramConfig(TrainConfig):
    """Settings of `python -m skatemount.search`; ``conf/search.yaml`` has the defaults.

    Attributes:
        search: Trials, space, sampler and pruner.
    """

    search: SearchConfig

    def validate(self) -> None:
        """Raise `ConfigError` for the first setting that cannot be used."""
        super().validate()
        self.search.validate("search")


@dataclass
class ReportConfig(TaskConfig):
    """Settings of `python -m skatemount.report`; ``conf/report.yaml`` has the defaults.

    Settings of the task count only where the user gives them, as for `PolicyConfig`.

    Attributes:
        run: Run or policy to report: what ``checkpoint`` of `PolicyConfig` may be; null for the newest run.
        against: Another one to compare it with; null compares its settings with the defaults of its stage.
        runs: Several of them to compare, in place of ``run``.
        sweep: Folder of a multirun whose runs are compared, in place of ``run``.
        paper: Write the page of the paper, in place of that of a run; ``run`` may add a curve.
        page: Content of the page.
        output: File of the page; null for ``report.html`` in the run's folder, or here without a run.
        seed: Seed of worlds and start states of the evaluations.
        torch_threads: Torch's threads; 0 takes every core.
        logger: Place of the runs.
    """

    run: str | None
    against: str | None
    runs: list[str]
    sweep: str | None
    paper: bool
    page: PageConfig
    output: str | None
    seed: int = field(metadata=number(0, MAX_SEED))
    torch_threads: int = field(metadata=number(1, 1024, zero="every core"))
    logger: RunsConfig

    def validate(self) -> None:
        """Raise `ConfigError` for the first setting that cannot be used."""
        super().validate()
        check_root(self.logger.root, "logger")
        self.page.validate("page")
        given = {"runs": self.runs, "sweep": self.sweep, "paper": "true" if self.paper else None}
        asked = [f"{name}={'[' + ','.join(v) + ']' if isinstance(v, list) else v}" for name, v in given.items() if v]
        if len(asked) > 1:
            raise ConfigError(f"{asked[0]} with {asked[1]}: a page is about one of them; leave out one")
        if asked and self.against is not None:
            raise ConfigError(f"against={self.against} with {asked[0]}: only run=<run> is compared with another one")
        if self.run is not None and (self.runs or self.sweep is not None):
            raise ConfigError(f"run={self.run} with {asked[0]}: a page is about one of them; leave out one")
        if self.paper and self.page.suites is not None:
            raise ConfigError(
                f"page.suites=[{','.join(self.page.suites)}] with paper=true: that page shows results that exist; "
                "leave page.suites out, or name files of results in page.results"
            )
        for name in ("run", "against", "sweep"):
            value = getattr(self, name) or ""
            if value.startswith("[") and value.endswith("]") and not Path(value).exists():
                raise ConfigError(f"{name}={value}: takes one name; runs={value} compares several")
        if len(self.runs) == 1:
            raise ConfigError(f"runs=[{self.runs[0]}] must name at least two runs; run={self.runs[0]} reports one")


PROGRAMS: dict[str, type[TaskConfig]] = {
    "train": TrainConfig,
    "evaluate": EvaluateConfig,
    "record": RecordConfig,
    "play": PlayConfig,
    "report": ReportConfig,
    "export": ExportConfig,
    "bench": BenchProgramConfig,
    "search": SearchProgramConfig,
}
"""Schema of each program; its YAML file has the same name."""
