"""Every setting, as dataclasses."""

from __future__ import annotations

from dataclasses import dataclass, field

from skatemount.config.bench import BenchConfig
from skatemount.config.files import check_stage
from skatemount.config.suite import SuiteConfig
from skatemount.curriculum.config import CurriculumConfig
from skatemount.envs.config.task import HOLD, TaskConfig
from skatemount.losses.config import AlgorithmConfig
from skatemount.models.config import NetworkConfig
from skatemount.utils.errors import ConfigError

PRECISIONS = ("highest", "medium", "bf16")


@dataclass
class StageConfig:
    """What a stage is called and starts from.

    Attributes:
        name: Of the stage.
        description: One line.
        init_from: Policy that the stage starts from; nothing if null.
        gate: Deterministic success in one of the training's evaluations that ends the training; only ``total_frames``
            does if null.
        renormalize: Take the observations' mean and deviation from the stage's own first batch, which nothing is
            learned from, and not from what the policy that it starts from saw.
    """

    name: str = ""
    description: str = ""
    init_from: str | None = None
    gate: float | None = None
    renormalize: bool = False


@dataclass
class CollectorConfig:
    """How a batch of experience is collected.

    Attributes:
        steps_per_env: Control steps a world between two updates.
        random_phase: Let the first episodes start at random phases, so that they do not all end at once.
        max_mounted_time: End an episode, as at its time limit, once the robot has stood on the board for so many
            seconds; null to let it stand. Evaluations always do.
    """

    steps_per_env: int = 24
    random_phase: bool = True
    max_mounted_time: float | None = None


@dataclass
class LoggerConfig:
    """What is written, and how often.

    Attributes:
        root: Folder of all runs.
        experiment: Folder of this experiment's runs below it.
        name: Of the run; the stage's name if null.
        tensorboard: Whether to write TensorBoard events.
        csv: Whether to write ``metrics.csv``, from which the curves are drawn.
        progress_every: Seconds between two lines of progress where the output is no terminal.
        plot_every: Seconds between two drawings of the learning curves.
        checkpoint_every: Iterations between two checkpoints.
        keep_checkpoints: How many of the newest are kept; the best is kept besides.
        evaluate_every: Iterations between two deterministic evaluations; 0 for none.
        evaluate_episodes: Episodes of each.
        final_episodes: Episodes of the evaluation at the end; 0 for none.
    """

    root: str = "runs"
    experiment: str = "skatemount"
    name: str | None = None
    tensorboard: bool = True
    csv: bool = True
    progress_every: float = 5.0
    plot_every: float = 60.0
    checkpoint_every: int = 100
    keep_checkpoints: int = 3
    evaluate_every: int = 50
    evaluate_episodes: int = 256
    final_episodes: int = 1000


@dataclass
class Config(TaskConfig):
    """Every setting; see ``conf/config.yaml``."""

    stage: StageConfig = field(default_factory=StageConfig)
    network: NetworkConfig = field(default_factory=NetworkConfig)
    algorithm: AlgorithmConfig = field(default_factory=AlgorithmConfig)
    curriculum: CurriculumConfig = field(default_factory=CurriculumConfig)
    collector: CollectorConfig = field(default_factory=CollectorConfig)
    logger: LoggerConfig = field(default_factory=LoggerConfig)
    bench: BenchConfig = field(default_factory=BenchConfig)
    seed: int = 0
    total_frames: int = 6_000_000
    precision: str = "medium"
    torch_threads: int = 0
    init_from: str | None = "stage"
    init_from_expand: bool = False
    resume: str | None = None
    checkpoint: str = "latest"
    pipeline: str | None = None
    switch_distance: float = 1.0
    suite: SuiteConfig | None = None
    episodes: int = 1000
    episode: int = 0
    json: str | None = None
    output: str | None = None

    def validate(self) -> None:
        """Raise `ConfigError` for the first setting that cannot be used."""
        super().validate()
        self.network.validate("network")
        self.algorithm.validate("algorithm")
        self.curriculum.validate("curriculum")
        self.bench.validate("bench")
        if self.suite is not None:
            self.suite.validate("suite")
        if self.curriculum.kind == "stages":
            if self.stage.name:
                raise ConfigError(
                    f"+stage={self.stage.name} with +curriculum={self.curriculum.name}: the curriculum runs its own "
                    f"stages ({', '.join(self.curriculum.stages)}): leave out one of the two"
                )
            for name, link in self.curriculum.stages.items():
                check_stage(name)
                self._check_gate(f"curriculum.stages.{name}.gate", link.gate)
        elif self.curriculum.kind != "none" and self.success != "mount":
            raise ConfigError(
                f"curriculum.kind={self.curriculum.kind} opens start states about the board, and stage "
                f"{self.stage.name} is not about mounting it: leave out the curriculum"
            )
        final, low, high = self.algorithm.final_std, self.network.min_std, self.network.max_std
        if final is not None and not low <= final <= high:
            raise ConfigError(
                f"algorithm.final_std={final} must be within network.min_std={low} and network.max_std={high}, from "
                "which it falls"
            )
        self._check_gate("stage.gate", self.stage.gate)
        if not self.logger.root:
            raise ConfigError("logger.root='' must name a folder, such as runs")
        for name in ("progress_every", "plot_every"):
            if not getattr(self.logger, name) >= 0:
                raise ConfigError(f"logger.{name}={getattr(self.logger, name)} must be 0 or more, in seconds")
        if self.precision not in PRECISIONS:
            raise ConfigError(f"precision={self.precision} must be one of {', '.join(PRECISIONS)}")
        for name in ("total_frames", "episodes"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name}={getattr(self, name)} must be at least 1")
        for name, most in (("seed", 2**62), ("episode", 2**40), ("torch_threads", 1024)):
            if not 0 <= getattr(self, name) <= most:
                raise ConfigError(f"{name}={getattr(self, name)} must be 0 or more, and at most {most}")
        if not self.switch_distance > 0:
            raise ConfigError(f"switch_distance={self.switch_distance} must be above 0, in metres")
        if self.collector.steps_per_env < 1:
            raise ConfigError(f"collector.steps_per_env={self.collector.steps_per_env} must be at least 1")
        if self.collector.max_mounted_time is not None and not self.collector.max_mounted_time >= HOLD:
            raise ConfigError(
                f"collector.max_mounted_time={self.collector.max_mounted_time} must be null or at least {HOLD:g}, "
                f"the seconds of "
                "standing that a success takes"
            )
        for name in ("checkpoint_every", "keep_checkpoints", "evaluate_episodes"):
            if getattr(self.logger, name) < 1:
                raise ConfigError(f"logger.{name}={getattr(self.logger, name)} must be at least 1")
        for name in ("evaluate_every", "final_episodes"):
            if getattr(self.logger, name) < 0:
                raise ConfigError(f"logger.{name}={getattr(self.logger, name)} must be 0 (none) or more")
        batch = self.physics.num_worlds * self.collector.steps_per_env
        if self.algorithm.minibatches > batch:
            raise ConfigError(
                f"algorithm.minibatches={self.algorithm.minibatches} must be at most the {batch} steps of a batch"
            )

    def _check_gate(self, where: str, gate: float | None) -> None:
        if gate is None:
            return
        if not 0 < gate <= 1:
            raise ConfigError(f"{where}={gate} must be a success rate above 0 and at most 1, or null for none")
        if not self.logger.evaluate_every:
            raise ConfigError(f"{where}={gate} needs evaluations: give logger.evaluate_every above 0, or {where}=null")
