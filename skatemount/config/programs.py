"""Settings of the programs other than training, as dataclasses; each refuses what does not concern it."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

from skatemount.config.bench import BenchConfig
from skatemount.config.film import FilmConfig
from skatemount.config.schema import MAX_SEED, TrainConfig, check_root
from skatemount.config.suite import SuiteConfig
from skatemount.envs.config.task import TaskConfig
from skatemount.utils.bounds import number

MAX_EPISODE = 2**40


@dataclass
class RunsConfig:
    """Place of the runs.

    Attributes:
        root: Folder of all runs.
    """

    root: str


@dataclass
class PolicyConfig(TaskConfig):
    """Settings that `EvaluateConfig` and `RecordConfig` share: a policy and the task to try it in.

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
        output: Folder for what is made.
    """

    checkpoint: str
    pipeline: str | None
    switch_distance: float = field(metadata=number(0, 100, "m", above=True))
    suite: SuiteConfig | None
    seed: int = field(metadata=number(0, MAX_SEED))
    torch_threads: int = field(metadata=number(1, 1024, zero="every core"))
    logger: RunsConfig
    output: str | None

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
    """

    episodes: int = field(metadata=number(1, 10**6))
    json: str | None


@dataclass
class RecordConfig(PolicyConfig):
    """Settings of `python -m skatemount.record`; ``conf/record.yaml`` has the defaults.

    Attributes:
        episode: Number of the episode to film, as the evaluation counts; null films the first success.
        film: Size, camera and speed of the film.
    """

    episode: int | None = field(metadata=number(0, MAX_EPISODE))
    film: FilmConfig

    def validate(self) -> None:
        """Raise `ConfigError` for the first setting that cannot be used."""
        super().validate()
        self.film.validate("film")


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


PROGRAMS: dict[str, type[TaskConfig]] = {
    "train": TrainConfig,
    "evaluate": EvaluateConfig,
    "record": RecordConfig,
    "bench": BenchProgramConfig,
}
"""Schema of each program; its YAML file has the same name."""
