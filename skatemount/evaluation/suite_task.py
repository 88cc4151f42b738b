"""Which tasks a policy is tried in."""

from __future__ import annotations

import copy
import functools
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import OmegaConf

from skatemount import config as configuration
from skatemount.agents.interface import check_interface
from skatemount.agents.switching import SwitchingAgent
from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.config import Config, PolicyConfig
from skatemount.config.files import load_file
from skatemount.config.keys import keys
from skatemount.config.suite import SuiteConfig
from skatemount.envs.config.task import TaskConfig
from skatemount.evaluation.evaluator import EVALUATION_SEED, NUM_WORLDS, Evaluator, mix_seeds
from skatemount.evaluation.records import EpisodeRecords
from skatemount.evaluation.results import Evaluation
from skatemount.utils.errors import ConfigError

_MACHINE = ("engine", "device", "threads", "max_contacts", "max_constraints")
"""Settings of the physics that do not come from the training."""


@dataclass
class EvaluationTask:
    """A policy and the test to put it to.

    Attributes:
        agent: The policy.
        name: Of the suite; of the policy's stage if it is tried in its own task.
        suite: The suite, none for the policy's own task.
        configs: The task's configuration by variant; a suite without variants has one, named "".
        overrides: What the user changed in it.
        seed: The user's.
    """

    agent: TrainedPolicy
    name: str
    suite: SuiteConfig | None
    configs: dict[str, Config]
    overrides: list[str]
    seed: int

    @classmethod
    def prepare(cls, config: PolicyConfig, overrides: Sequence[str]) -> list[EvaluationTask]:
        """Load the policy that the command line names, and work out its tasks.

        Args:
            config: As composed from the command line; its ``checkpoint``, or ``pipeline`` and ``switch_distance``,
                ``suite``, ``seed`` and ``logger.root`` count.
            overrides: What the user asked for; see `evaluation_config`.

        Returns:
            One trial for each suite.

        Raises:
            ConfigError: No such policy, suite or setting.
        """
        if config.pipeline is None:
            agent = TrainedPolicy.load(config.checkpoint, config.logger.root)
        else:
            agent = SwitchingAgent.load_pair(config.pipeline, config.switch_distance, config.logger.root)
        asked = [o for o in overrides if _key(o).partition(".")[0] in keys(TaskConfig)]
        suites = [config.suite] if config.suite is None else members_of(config.suite)
        return [cls.of(agent, suite, asked, config.seed) for suite in suites]

    @classmethod
    def of(
        cls,
        agent: TrainedPolicy,
        suite: SuiteConfig | None,
        overrides: Sequence[str] = (),
        seed: int = 0,
    ) -> EvaluationTask:
        """Work out the tasks of one suite.

        Args:
            agent: The policy.
            suite: A suite with a stage; none for the policy's own task.
            overrides: What the user changes in the task; see `evaluation_config`.
            seed: The user's.

        Raises:
            ConfigError: No such setting.
        """
        variants = suite.variants if suite is not None and suite.variants else {"": []}
        configs = {
            name: evaluation_config(agent.config, suite, overrides, variant=changes)
            for name, changes in variants.items()
        }
        name = suite.name if suite is not None else agent.card.stage or "its own task"
        return cls(agent, name, suite, configs, list(overrides), seed)

    @property
    def file_stem(self) -> str:
        """What files about it are called."""
        return f"{self.agent.name.replace('/', '_')}_{self.name}_seed{self.seed}"

    def variant_of(self, episode: int) -> tuple[str, int]:
        """Where an episode belongs: variants take turns, so that its number does not depend on how many there are.

        Args:
            episode: Its number in the trial, from 0.

        Returns:
            The variant, and the episode's number among those of the variant.
        """
        index, turn = episode % len(self.configs), episode // len(self.configs)
        return list(self.configs)[index], turn

    def numbered(self, variant: str, records: EpisodeRecords) -> EpisodeRecords:
        """Episodes of a variant with their numbers in the trial; the reverse of `variant_of`."""
        index = list(self.configs).index(variant)
        number = records.number * len(self.configs) + index
        return replace(records, number=number, variant=torch.full_like(number, index))

    def evaluator(self, variant: str) -> Evaluator:
        """What plays the episodes of a variant; to be closed. The policy is moved to where they are played.

        Raises:
            ConfigError: The policy does not fit the task.
        """
        config = self.configs[variant]
        suite_seed = 0 if self.suite is None else self.suite.seed
        seed = mix_seeds(EVALUATION_SEED + self.seed, suite_seed, list(self.configs).index(variant))
        evaluator = Evaluator(config, config.physics.num_worlds, seed)
        try:
            check_interface(self.agent.card, evaluator.env.task, self.agent.settings[0])
        except ConfigError:
            evaluator.close()
            raise
        self.agent.to(evaluator.env.device)
        return evaluator

    def evaluate(self, episodes: int, progress: Callable[[float, str], None] | None = None) -> Evaluation:
        """Put the policy to the test.

        Args:
            episodes: How many, of all variants together; they take turns.
            progress: Called with the share that is done, 0 to 1, and the variant.

        Returns:
            The results, with everything that repeating them takes.

        Raises:
            ConfigError: Fewer than 1 episode, or the policy does not fit the task.
        """
        variants = list(self.configs)
        parts: list[Evaluation] = []
        for i, name in enumerate(variants[: max(episodes, 1)]):
            before = sum(part.episodes for part in parts)
            count = len(range(i, episodes, len(variants)))

            def report(done: int, total: int, before: int = before, count: int = count, name: str = name) -> None:
                if progress is not None:
                    progress((before + count * done / total) / episodes, name)

            evaluator = self.evaluator(name)
            try:
                part = evaluator.run(self.agent.policy, count, report)
            finally:
                evaluator.close()
            part.records = self.numbered(name, part.records)
            parts.append(part)
        records = EpisodeRecords.cat([part.records for part in parts])
        return Evaluation(
            records=records[records.number.argsort()],
            ends=parts[0].ends,
            variants=variants if len(variants) > 1 else [],
            evaluated=self.describe() | parts[0].evaluated,
        )

    def record_command(self, episode: int) -> str:
        """The command that films an episode exactly as it was evaluated."""
        words = ["python", "-m", "skatemount.record", *self.agent.settings]
        if self.suite is not None:
            words.append(f"suite={self.suite.name}")
        if self.seed:
            words.append(f"seed={self.seed}")
        return shlex.join([*words, *self.overrides, f"episode={episode}"])

    def describe(self) -> dict[str, Any]:
        """What is tried, as plain values: all that repeating it takes."""
        card = self.agent.card
        return {
            "checkpoint": self.agent.name,
            "stage": card.stage,
            "frames": card.frames,
            "sha256": card.sha256,
            "suite": self.name,
            "definition": None if self.suite is None else vars(self.suite) | {},
            "overrides": self.overrides,
            "seed": self.seed,
            "record": self.record_command(0).removesuffix("0") + "<episode>",
        }


def load_suite(name: str) -> SuiteConfig:
    """A suite by its name.

    Raises:
        ConfigError: There is none; the line says which there are.
    """
    found = OmegaConf.to_object(OmegaConf.merge(OmegaConf.structured(SuiteConfig), load_file("suite", name)))
    assert isinstance(found, SuiteConfig)
    found.validate()
    return found


def members_of(suite_config: SuiteConfig) -> list[SuiteConfig]:
    """The suite itself, or the suites that it is made of.

    Raises:
        ConfigError: A member that does not exist, or that is made of others itself.
    """
    if not suite_config.members:
        return [suite_config]
    members = [load_suite(name) for name in suite_config.members]
    for each in members:
        if each.members:
            raise ConfigError(f"suite {suite_config.name}: {each.name} is made of other suites itself; name those")
    return members


def evaluation_config(
    policy: Config, suite: SuiteConfig | None, overrides: Sequence[str] = (), variant: Sequence[str] = ()
) -> Config:
    """The configuration that a policy is tried in.

    1. Without a suite it is the one that the policy was trained in. With one it is that of the suite's stage, but what
       belongs to the policy stays as in its training: robot, observation, network, control rate (``physics.timestep``
       and ``physics.substeps``), and, where a board is to be mounted, ``command`` if it was switched off there.
    2. Engine, device, its memory, threads and number of worlds belong to the machine that evaluates: the defaults of
       here, not of the training.
    3. On top of both comes what the suite, the variant and the user ask for, setting by setting: ``start.x=[0,1]``
       changes that value alone, and ``board=longboard`` the whole group, as it is composed in that stage. The user has
       the last word.

    Args:
        policy: The policy's own configuration.
        suite: A suite with a stage, or none.
        overrides: The user's, in Hydra's syntax, without the verbs' own settings.
        variant: Overrides of a variant of the suite.

    Returns:
        A configuration of its own.

    Raises:
        ConfigError: An unknown setting, or an override that stands for more than one group.
    """
    for override in overrides:
        if (key := _key(override)) in ("stage", "experiment"):
            instead = "suite=<name>" if key == "stage" else "the settings themselves"
            raise ConfigError(f"{override}: a policy brings its own {key}; give {instead} instead")
    stage = policy.stage.name if suite is None else suite.stage
    # A policy may come from a stage that is not there any more.
    known = suite is not None or stage in configuration.stages()
    changes = [] if suite is None else [*suite.overrides, *variant]
    theirs = {_key(o) for o in overrides}
    changes = [*(o for o in changes if _key(o) not in theirs), *overrides]
    asked = configuration.to_dict(configuration.compose(stage if known else None, changes))

    result = copy.deepcopy(policy if suite is None else _stage(stage))
    result.robot, result.observation, result.network = policy.robot, policy.observation, policy.network
    result.physics.timestep, result.physics.substeps = policy.physics.timestep, policy.physics.substeps
    if policy.command.mode == "zero" and result.success == "mount":
        result.command = policy.command
    values = configuration.to_dict(result)
    values["physics"] |= {name: asked["physics"][name] for name in _MACHINE}
    values["physics"]["num_worlds"] = NUM_WORLDS
    for override in changes:
        _copy(_key(override).replace("/", ".").split("."), asked, values)
    return configuration.from_dict(values)


@functools.lru_cache
def _stage(name: str) -> Config:
    """A stage's settings; composing them takes a while, and many suites share a stage."""
    return configuration.compose(name)


def _key(override: str) -> str:
    """The setting or group that an override is about."""
    return OverridesParser.create().parse_override(override).key_or_group


def _copy(path: list[str], source: dict[str, Any], target: dict[str, Any]) -> None:
    """Make one entry of the target the source's, or delete it if the source has none."""
    *parents, last = path
    for name in parents:
        source, target = source.get(name, {}), target.setdefault(name, {})
    if last in source:
        target[last] = copy.deepcopy(source[last])
    else:
        target.pop(last, None)
