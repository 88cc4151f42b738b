"""The configuration as one validated whole: Hydra composes the YAML groups, dataclasses say what they may hold."""

from __future__ import annotations

import dataclasses
import difflib
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import hydra
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig, ListConfig, OmegaConf

import skatemount
from skatemount.benchmark.suites import SuiteConfig
from skatemount.curriculum.base import CurriculumConfig
from skatemount.envs import success
from skatemount.envs.settings import TaskConfig
from skatemount.errors import ConfigError
from skatemount.losses.ppo import AlgorithmConfig
from skatemount.models import NetworkConfig
from skatemount.speed.settings import BenchConfig

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
        steps: Control steps a world between two updates.
        random_phase: Let the first episodes start at random phases, so that they do not all end at once.
        enough: End an episode, as at its time limit, once the robot has stood on the board for so many seconds; null
            to let it stand. Evaluations always do.
    """

    steps: int = 24
    random_phase: bool = True
    enough: float | None = None


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
    grow: bool = False
    resume: str | None = None
    checkpoint: str = "latest"
    pipeline: str | None = None
    handover: float = 1.0
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
        if not self.handover > 0:
            raise ConfigError(f"handover={self.handover} must be above 0, in metres")
        if self.collector.steps < 1:
            raise ConfigError(f"collector.steps={self.collector.steps} must be at least 1")
        if self.collector.enough is not None and not self.collector.enough >= success.HOLD:
            raise ConfigError(
                f"collector.enough={self.collector.enough} must be null or at least {success.HOLD:g}, the seconds of "
                "standing that a success takes"
            )
        for name in ("checkpoint_every", "keep_checkpoints", "evaluate_episodes"):
            if getattr(self.logger, name) < 1:
                raise ConfigError(f"logger.{name}={getattr(self.logger, name)} must be at least 1")
        for name in ("evaluate_every", "final_episodes"):
            if getattr(self.logger, name) < 0:
                raise ConfigError(f"logger.{name}={getattr(self.logger, name)} must be 0 (none) or more")
        batch = self.physics.num_worlds * self.collector.steps
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


def _schema() -> DictConfig:
    """The dataclasses as Hydra's schema; rows may be added to the tables of terms, which check their own names."""
    schema = OmegaConf.structured(Config)
    for table in ("reward", "termination", "observation.policy", "observation.privileged"):
        OmegaConf.set_struct(OmegaConf.select(schema, table), False)
    return schema


ConfigStore.instance().store(name="schema", node=_schema())


def config_dir() -> Path:
    """Folder of the YAML groups: inside the package in a wheel, beside it in a clone."""
    package = Path(skatemount.__file__).parent
    for folder in (package / "conf", package.parent / "conf"):
        if (folder / "config.yaml").is_file():
            return folder
    raise ConfigError(f"no configuration found beside or inside {package}: install skatemount again")


def stages() -> dict[str, str]:
    """Every stage with its one-line description."""
    return _described("stage", "stage.description")


def suites() -> dict[str, str]:
    """Every suite with its one-line description."""
    return _described("suite", "description")


def _described(group: str, key: str) -> dict[str, str]:
    files = sorted((config_dir() / group).glob("*.yaml"))
    return {path.stem: str(OmegaConf.select(OmegaConf.load(path), key, default="")) for path in files}


def check_stage(name: str) -> None:
    """Raise `ConfigError` unless a stage of that name exists."""
    if name not in stages():
        raise ConfigError(f"stage={name} is not a stage; there are: {', '.join(stages())}")


def check_suite(name: str) -> None:
    """Raise `ConfigError` unless a suite of that name exists."""
    if name not in suites():
        raise ConfigError(f"suite={name} is not a suite; there are: {', '.join(suites())}")


def to_object(config: DictConfig | ListConfig) -> Config:
    """A composed configuration as dataclasses, validated.

    Raises:
        ConfigError: A value that cannot be used.
    """
    result = OmegaConf.to_object(config)
    assert isinstance(result, Config)
    result.validate()
    return result


def compose(stage: str | None = None, overrides: Sequence[str] = ()) -> Config:
    """Compose a configuration from Python; works while a Hydra application is running, too.

    Args:
        stage: Name of a stage, or none.
        overrides: Further settings in Hydra's syntax.

    Raises:
        ConfigError: An unknown stage, setting or value.
    """
    if stage is not None:
        check_stage(stage)
        overrides = [f"+stage={stage}", *overrides]
    # Hydra knows one application at a time: a running one steps aside.
    running, GlobalHydra.instance().hydra = GlobalHydra.instance().hydra, None
    try:
        with hydra.initialize_config_dir(str(config_dir().absolute()), version_base="1.3"):
            composed = hydra.compose("config", list(overrides))
    except Exception as error:
        raise ConfigError(one_line(error)) from error
    finally:
        GlobalHydra.instance().hydra = running
    return to_object(composed)


def compose_task(stage: str | None = None, overrides: Sequence[str] = ()) -> TaskConfig:
    """The task's part of `compose`."""
    return compose(stage, overrides)


def from_dict(values: dict[str, Any]) -> Config:
    """The configuration that a run or a card has saved.

    Raises:
        ConfigError: It does not fit this version's settings.
    """
    try:
        return to_object(OmegaConf.merge(OmegaConf.structured(Config), values))
    except ConfigError:
        raise
    except Exception as error:
        raise ConfigError(f"saved configuration: {one_line(error)}") from error


def to_dict(config: Config) -> dict[str, Any]:
    """A configuration as plain values."""
    values = OmegaConf.to_container(OmegaConf.structured(config))
    assert isinstance(values, dict)
    return values  # type: ignore[return-value]


def one_line(error: BaseException) -> str:
    """What an error of Hydra or OmegaConf says, without the lines that are about their insides."""
    chain: list[BaseException] = []
    cause: BaseException | None = error
    while cause is not None:
        chain.append(cause)
        cause = cause.__cause__ or cause.__context__
    said: list[str] = []
    for each in chain:
        lines = [line.strip() for line in str(each).splitlines()]
        kept = [
            line
            for line in lines
            if line
            # What OmegaConf says before it fills in the value; it says so again with it.
            and "$VALUE" not in line
            and not line.startswith(
                (
                    "reference_type=",
                    "object_type=",
                    "Config search path",
                    "set HYDRA_FULL_ERROR",
                    "provider=",
                    "full_key:",
                    "To append to your config",
                )
            )
        ]
        keys = [line.removeprefix("full_key:").strip() for line in lines if line.startswith("full_key:")]
        text = " ".join(kept)
        if not text or any(text in earlier for earlier in said):
            continue
        if keys and keys[0] not in text:
            text += f" ({keys[0]})"
        said.append(text)
    text = ": ".join(said)
    if whole := re.search(r"Value '(\d+)\.0' of type 'float' could not be converted to Integer", text):
        text += f"; write {whole[1]}"
    missing = re.search(r"Key '(\w+)' (?:not in '(\w+)'|is not in struct)", text)
    close = difflib.get_close_matches(missing[1], _settings(missing[2]), n=3) if missing else []
    return f"{text}; did you mean {' or '.join(close)}?" if close else text


def _settings(kind: str | None, of: type = Config) -> list[str]:
    """Names of the settings of a dataclass of the configuration; of all of them if it is not known."""
    names: list[str] = []
    for part in dataclasses.fields(of):
        if kind in (None, of.__name__):
            names.append(part.name)
        if isinstance(part.default_factory, type) and dataclasses.is_dataclass(part.default_factory):
            names += _settings(kind, part.default_factory)
    return names
