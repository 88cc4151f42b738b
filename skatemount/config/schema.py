"""Settings of a training, as dataclasses. They hold no values: YAML is the only place of a default."""

from __future__ import annotations

from dataclasses import dataclass, field

from skatemount.config.files import check_choice
from skatemount.config.registries import CALLBACKS
from skatemount.curriculum.config import CurriculumConfig
from skatemount.envs.config.task import HOLD, TaskConfig
from skatemount.losses.config import AlgorithmConfig
from skatemount.models.config import NetworkConfig
from skatemount.runs.loggers import LOGGERS
from skatemount.utils.bounds import check_bounds, number
from skatemount.utils.errors import ConfigError, check_name

PRECISIONS = ("highest", "medium", "bf16")
_STAND = "a success takes that much standing"
MAX_SEED = 2**62
"""Largest seed; torch's generators take no larger ones."""


@dataclass
class StageConfig:
    """Name, initial policy and end of a stage.

    Attributes:
        name: Name of the stage.
        description: One line about it.
        init_from: Policy that the stage starts from; null starts from scratch.
        gate: Success rate of an evaluation at which the training ends early; null trains for ``total_frames``.
        renormalize: Take the observations' mean and deviation from the first batch, which is not learned from,
            instead of the initial policy's.
    """

    name: str
    description: str
    init_from: str | None
    gate: float | None = field(metadata=number(0, 1, above=True))
    renormalize: bool


@dataclass
class CollectorConfig:
    """Collection of rollouts.

    Attributes:
        steps_per_env: Control steps of each world between two updates.
        random_phase: Start the first episodes at random phases, so that they do not all end at once.
        max_mounted_time: Truncate an episode after the robot has stood on the board for this long, s; null lets it
            stand until the time limit. Evaluations always do.
    """

    steps_per_env: int = field(metadata=number(1, 100_000))
    random_phase: bool
    max_mounted_time: float | None = field(metadata=number(HOLD, 3600, "s, or null", why=_STAND))

    def validate(self, where: str = "collector") -> None:
        """Raise `ConfigError` for values that cannot be used."""
        check_bounds(self, where)


@dataclass
class LoggerConfig:
    """Output of a run.

    Attributes:
        root: Folder of all runs.
        experiment: Folder below ``root`` for the runs of this experiment.
        name: Name of the run; null takes the stage's name.
        tensorboard: Write TensorBoard events.
        jsonl: Write ``metrics.jsonl``, from which the learning curves are drawn.
        loggers: Further loggers: ``wandb``, ``trackio``, names that plugins registered, or ``module:Class`` of your
            own.
        progress_every: Seconds between two lines of progress when the output is not a terminal.
        plot_every: Seconds between two updates of the learning curves' picture.
        dump_diverged: Number of worlds whose physics failed to write into the run's folder ``diverged``, for
            `skatemount.replay_diverged`; 0 for none. Each control step takes a copy of all states until they are
            written.
        checkpoint_every: Iterations between two checkpoints.
        keep_checkpoints: Number of the newest checkpoints to keep; the best one is kept as well.
        evaluate_every: Iterations between two evaluations during training; 0 for none.
        evaluate_episodes: Episodes of each of them.
        final_episodes: Episodes of the evaluation at the end; 0 for none.
    """

    root: str
    experiment: str
    name: str | None
    tensorboard: bool
    jsonl: bool
    loggers: list[str]
    progress_every: float = field(metadata=number(0, 1e6, "s"))
    plot_every: float = field(metadata=number(0, 1e6, "s"))
    dump_diverged: int = field(metadata=number(1, 10_000, "files", zero="none"))
    checkpoint_every: int = field(metadata=number(1, 10**9))
    keep_checkpoints: int = field(metadata=number(1, 10**6))
    evaluate_every: int = field(metadata=number(1, 10**9, "iterations", zero="none"))
    evaluate_episodes: int = field(metadata=number(1, 10**6))
    final_episodes: int = field(metadata=number(1, 10**6, zero="none"))

    def validate(self, where: str = "logger") -> None:
        """Raise `ConfigError` for values that cannot be used."""
        check_root(self.root, where)
        for name in self.loggers:
            LOGGERS.check_name(name, f"{where}.loggers")
            if name in ("tensorboard", "jsonl"):
                raise ConfigError(f"{where}.loggers={name}: use {where}.{name}=true")
            if self.loggers.count(name) > 1:
                raise ConfigError(f"{where}.loggers: {name} is there twice")
        check_bounds(self, where)


@dataclass
class DistributedConfig:
    """Several processes, or ranks, that train one policy; see `skatemount.training.distributed`.

    Attributes:
        timeout: Time without an answer after which a rank counts as lost and the training ends, s.
        check_every: Iterations between two comparisons of the weights of all ranks; 0 for none.
    """

    timeout: float = field(metadata=number(1, 86_400, "s"))
    check_every: int = field(metadata=number(1, 10**9, "iterations", zero="none"))

    def validate(self, where: str = "distributed") -> None:
        """Raise `ConfigError` for values that cannot be used."""
        check_bounds(self, where)


@dataclass
class TrainConfig(TaskConfig):
    """Settings of a training; ``conf/train.yaml`` has the defaults.

    Attributes:
        stage: Name and initial policy of the stage.
        network: Sizes of the networks.
        algorithm: Learning algorithm and its hyperparameters.
        curriculum: Choice of the start states during the training.
        collector: Collection of rollouts.
        callbacks: Callbacks in addition to the default ones: names that plugins registered, or ``module:Class`` of your
            own.
        logger: Output of a run.
        distributed: Several processes, or ranks, that train one policy.
        seed: Seed of all random numbers; a rank adds its number.
        total_frames: Environment steps of all worlds, those of all ranks together, at which the training ends.
        precision: Precision of float32 matrix products, ``highest`` or ``medium``, or ``bf16`` for the updates.
        torch_threads: Torch's threads; 0 takes every core.
        init_from: Initial policy: ``stage`` (the one that the stage names), null (from scratch), or what ``checkpoint``
            of `EvaluateConfig` may be.
        init_from_expand: Allow a network that is larger than the initial policy's, or has more observations.
        init_from_other_robot: Allow an initial policy of another robot with the same joints.
        resume: Run to resume; null starts a new one.
    """

    stage: StageConfig
    network: NetworkConfig
    algorithm: AlgorithmConfig
    curriculum: CurriculumConfig
    collector: CollectorConfig
    callbacks: list[str]
    logger: LoggerConfig
    distributed: DistributedConfig
    seed: int = field(metadata=number(0, MAX_SEED))
    total_frames: int = field(metadata=number(1, 10**12))
    precision: str
    torch_threads: int = field(metadata=number(1, 1024, zero="every core"))
    init_from: str | None
    init_from_expand: bool
    init_from_other_robot: bool
    resume: str | None

    def validate(self) -> None:
        """Raise `ConfigError` for the first setting that cannot be used; `validate_terms` checks the tables."""
        super().validate()
        check_bounds(self.stage, "stage")
        check_name("stage.name", self.stage.name)
        self.network.validate("network")
        self.algorithm.validate("algorithm")
        self.curriculum.validate("curriculum")
        self.collector.validate("collector")
        self.logger.validate("logger")
        self.distributed.validate("distributed")
        for name in self.callbacks:
            CALLBACKS.check_name(name, "callbacks")
            if self.callbacks.count(name) > 1:
                raise ConfigError(f"callbacks: {name} is there twice")
        self._validate_curriculum()
        self._check_gate("stage.gate", self.stage.gate)
        final, low, high = self.algorithm.final_std, self.network.min_std, self.network.max_std
        if final is not None and not low <= final <= high:
            raise ConfigError(
                f"algorithm.final_std={final} must be between network.min_std={low} and network.max_std={high}, its "
                "initial value"
            )
        if self.precision not in PRECISIONS:
            raise ConfigError(f"precision={self.precision} must be one of {', '.join(PRECISIONS)}")
        batch = self.physics.num_worlds * self.collector.steps_per_env
        if self.algorithm.minibatches > batch:
            raise ConfigError(
                f"algorithm.minibatches={self.algorithm.minibatches} must be at most the {batch} steps of a batch"
            )

    def _validate_curriculum(self) -> None:
        if self.curriculum.kind == "stages":
            if self.stage.name:
                raise ConfigError(
                    f"stage={self.stage.name} with curriculum={self.curriculum.name}: this curriculum has its own "
                    f"stages ({', '.join(self.curriculum.stages)}); leave out one of the two"
                )
            for name, link in self.curriculum.stages.items():
                check_choice("stage", name)
                self._check_gate(f"curriculum.stages.{name}.gate", link.gate)

    def validate_terms(self) -> None:
        """Raise `ConfigError` for an unknown task or term, or a curriculum that the task cannot have."""
        super().validate_terms()
        from skatemount.envs.tasks import TASKS  # it needs torch

        if self.curriculum.kind not in ("none", "stages") and not TASKS.get(self.success).start_curricula:
            raise ConfigError(
                f"curriculum.kind={self.curriculum.kind} cannot choose the start states of success={self.success}, the "
                f"task of stage {self.stage.name}; use curriculum=none"
            )

    def _check_gate(self, where: str, gate: float | None) -> None:
        if gate is not None and not self.logger.evaluate_every:
            raise ConfigError(f"{where}={gate} needs evaluations: set logger.evaluate_every above 0, or {where}=null")


def check_root(root: str, where: str) -> None:
    """Raise `ConfigError` unless the folder of all runs has a name."""
    if not root:
        raise ConfigError(f"{where}.root='' must name a folder, such as runs")
