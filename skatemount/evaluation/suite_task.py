"""`EvaluationTask`: a policy and the settings that it is evaluated in, from a suite or from its own training."""

from __future__ import annotations

import copy
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from skatemount import config as configuration
from skatemount.agents.interface import check_interface
from skatemount.agents.switching import SwitchingAgent
from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.config import PolicyConfig, TrainConfig
from skatemount.config.files import choices, find_file, load_file
from skatemount.config.keys import keys
from skatemount.config.overrides import refuse_text
from skatemount.config.plugins import modules_of, written
from skatemount.config.suite import SuiteConfig
from skatemount.envs.config.task import TaskConfig
from skatemount.envs.tasks import TASKS
from skatemount.evaluation.evaluator import EVALUATION_SEED, NUM_WORLDS, Evaluator, mix_seeds
from skatemount.evaluation.records import EpisodeRecords
from skatemount.evaluation.results import Evaluation
from skatemount.utils.cores import available_cores
from skatemount.utils.errors import ConfigError
from skatemount.utils.formatting import format_changes

_MACHINE = ("engine", "device", "threads", "max_contacts", "max_constraints")
"""Settings of the physics that are the machine's, not the training's."""

_INSTEAD = {
    "stage": "suite=<name>",
    "experiment": "the settings themselves",
    "task": "suite=<name>, or success=<name> for the criterion and metrics alone,",
}
"""Hints for choices that an evaluation refuses, because the suite or the policy's training makes them."""


@dataclass
class EvaluationTask:
    """A policy and the task that it is evaluated in.

    Attributes:
        agent: The policy.
        name: Name of the suite; the policy's stage if it is evaluated in its own task.
        suite: The suite; None for the policy's own task.
        configs: Settings of the task by variant. A suite without variants has one, named "".
        overrides: The user's overrides of the task's settings.
        seed: The user's seed.
        torch_threads: Torch's number of threads.
        suite_overrides: The user's changes of the suite itself, such as ``suite.seed=5``.
    """

    agent: TrainedPolicy
    name: str
    suite: SuiteConfig | None
    configs: dict[str, TrainConfig]
    overrides: list[str]
    seed: int
    torch_threads: int = 1
    suite_overrides: list[str] = field(default_factory=list)

    @classmethod
    def prepare(cls, config: PolicyConfig, overrides: Sequence[str]) -> list[EvaluationTask]:
        """Load the policy that the command line names, and compose its tasks.

        Args:
            config: Settings composed from the command line. Used are ``checkpoint``, or ``pipeline`` and
                ``switch_distance``, ``suite``, ``seed`` and ``logger.root``.
            overrides: The user's overrides; see `evaluation_config`.

        Returns:
            A task for each suite.

        Raises:
            ConfigError: There is no such policy, suite or setting, both ``pipeline`` and ``checkpoint`` are given, or
                a setting cannot matter.
        """
        if config.pipeline is not None and (given := [o for o in overrides if _key(o) == "checkpoint"]):
            raise ConfigError(
                f"{given[0]} with pipeline={config.pipeline}: a pipeline names both policies; leave out one"
            )
        if config.pipeline is None:
            agent = TrainedPolicy.load(config.checkpoint, config.logger.root)
        else:
            agent = SwitchingAgent.load_pair(config.pipeline, config.switch_distance, config.logger.root)
        asked = [o for o in overrides if _key(o).partition(".")[0] in {*keys(TaskConfig), "task"}]
        suites = [config.suite] if config.suite is None else members_of(config.suite)
        of_suite = [o for o in overrides if _key(o).startswith("suite.")]
        if config.suite is not None and config.suite.members:
            if lost := [o for o in of_suite if _key(o) != "suite.members"]:
                raise ConfigError(f"{lost[0]} with suite={config.suite.name}: its suites have settings of their own; "
                                  f"name one of {', '.join(config.suite.members)}")  # fmt: skip
            of_suite = []
        tasks = [cls.of(agent, suite, asked, config.seed) for suite in suites]
        for task in tasks:
            task.torch_threads = config.torch_threads or available_cores()
            task.suite_overrides = of_suite
        return tasks

    @classmethod
    def of(
        cls,
        agent: TrainedPolicy,
        suite: SuiteConfig | None,
        overrides: Sequence[str] = (),
        seed: int = 0,
    ) -> EvaluationTask:
        """Compose the task of one suite.

        Args:
            agent: The policy.
            suite: A suite with a stage; None for the policy's own task.
            overrides: The user's overrides of the task's settings; see `evaluation_config`.
            seed: The user's seed.

        Raises:
            ConfigError: There is no such setting, variants have different tasks, or the overrides are a text.
        """
        refuse_text(overrides)
        variants = suite.variants if suite is not None and suite.variants else {"": []}
        configs = {
            name: evaluation_config(agent.config, suite, overrides, variant=changes)
            for name, changes in variants.items()
        }
        if len(tasks := sorted({config.success for config in configs.values()})) > 1:
            raise ConfigError(f"suite.variants: success is {' and '.join(tasks)}; the variants must have one task")
        name = suite.name if suite is not None else agent.card.stage or "its own task"
        return cls(agent, name, suite, configs, list(overrides), seed)

    @property
    def changed_by(self) -> list[str]:
        """The user's settings that make the test another one than the suite, or than the policy's own task.

        Settings of the machine do not count, nor do those that the suite has itself.
        """
        machine = {"plugins", *(f"physics.{name}" for name in _MACHINE)}
        own = [] if self.suite is None else self.suite.overrides
        return [*self.suite_overrides, *(o for o in self.overrides if _key(o) not in machine and o not in own)]

    @property
    def title(self) -> str:
        """Policy and suite in words, and by which settings the suite was changed."""
        return f"{self.agent.name} on {self.named()}"

    def named(self, but: str = "") -> str:
        """Return the suite and the settings that changed it in words, but for one that is told elsewhere."""
        return self.name + format_changes([each for each in self.changed_by if each != but])

    @property
    def file_stem(self) -> str:
        """Name of its files, without extension."""
        return f"{self.agent.name.replace('/', '_')}_{self.name}_seed{self.seed}"

    def variant_of(self, episode: int) -> tuple[str, int]:
        """Return the variant of an episode, and the episode's number within the variant.

        Variants take turns, so the variant does not depend on the number of episodes.

        Args:
            episode: Number of the episode in the evaluation, from 0.
        """
        index, turn = episode % len(self.configs), episode // len(self.configs)
        return list(self.configs)[index], turn

    def numbered(self, variant: str, records: EpisodeRecords) -> EpisodeRecords:
        """Return the records of a variant with their numbers in the evaluation; the reverse of `variant_of`."""
        index = list(self.configs).index(variant)
        number = records.number * len(self.configs) + index
        return replace(records, number=number, variant=torch.full_like(number, index))

    def evaluator(self, variant: str) -> Evaluator:
        """Return the evaluator of a variant, and move the policy to its device. The caller closes the evaluator.

        Raises:
            ConfigError: The policy does not fit the task.
        """
        config = self.configs[variant]
        suite_seed = 0 if self.suite is None else self.suite.seed
        seed = mix_seeds(EVALUATION_SEED + self.seed, suite_seed, list(self.configs).index(variant))
        evaluator = Evaluator(config, config.physics.num_worlds, seed, self.torch_threads)
        try:
            check_interface(self.agent.card, evaluator.env.task, self.agent.settings[0])
        except ConfigError:
            evaluator.close()
            raise
        self.agent.to(evaluator.env.device)
        return evaluator

    def evaluate(self, episodes: int, progress: Callable[[float, str], None] | None = None) -> Evaluation:
        """Evaluate the policy.

        Args:
            episodes: Number of episodes of all variants together.
            progress: Called with the share of the work that is done, 0 to 1, and the variant.

        Returns:
            The results, with all that is needed to repeat them.

        Raises:
            ConfigError: ``episodes`` is below 1, or the policy does not fit the task.
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
            end_names=parts[0].end_names,
            task=parts[0].task,
            most=parts[0].most,
            variants=variants if len(variants) > 1 else [],
            evaluated=self.describe() | parts[0].evaluated,
            boards=parts[0].boards if len(variants) == 1 else 0,
        )

    def record_command(self, episode: int) -> str:
        """Return the command that films an episode exactly as it was evaluated."""
        words = ["python", "-m", "skatemount.record", *configuration.config_dir_options(), *self.agent.settings]
        if self.suite is not None:
            words += [f"suite={self.suite.name}", *self.suite_overrides]
        if self.seed:
            words.append(f"seed={self.seed}")
        if self.torch_threads > 1:
            words.append(f"torch_threads={self.torch_threads}")
        modules = [*self.agent.modules, *modules_of(next(iter(self.configs.values())), training=False)]
        if modules:
            words.append(written(list(dict.fromkeys(modules))))
        others = [o for o in self.overrides if _key(o) != "plugins"]
        return shlex.join([*words, *others, f"episode={episode}"])

    def describe(self) -> dict[str, Any]:
        """Return policy, suite, overrides and seed as plain values: all that is needed to repeat the evaluation."""
        card = self.agent.card
        return {
            "checkpoint": self.agent.name,
            "stage": card.stage,
            "frames": card.frames,
            "sha256": card.sha256,
            "suite": self.name,
            "definition": None if self.suite is None else vars(self.suite) | {},
            "overrides": self.overrides,
            "changed_by": self.changed_by,
            "seed": self.seed,
            "record": self.record_command(0).removesuffix("0") + "<episode>",
        }


def load_suite(name: str) -> SuiteConfig:
    """Read a suite from its file.

    Raises:
        ConfigError: There is no such suite, and the message lists those that there are; or its file is not valid.
    """
    # Below "suite", errors name the same keys as on the command line.
    schema = OmegaConf.create({"suite": OmegaConf.structured(SuiteConfig)})
    try:
        found = OmegaConf.to_object(OmegaConf.merge(schema, {"suite": load_file("suite", name)}).suite)
    except OmegaConfBaseException as error:
        raise ConfigError(f"{find_file('suite', name)}: {configuration.one_line(error)}") from error
    assert isinstance(found, SuiteConfig)
    found.validate()
    return found


def members_of(suite_config: SuiteConfig) -> list[SuiteConfig]:
    """Return the members of a suite of suites, or the suite itself if it has none.

    Raises:
        ConfigError: A member does not exist, or has members itself.
    """
    if not suite_config.members:
        return [suite_config]
    members = [load_suite(name) for name in suite_config.members]
    for each in members:
        if each.members:
            raise ConfigError(
                f"suite.members={suite_config.members}: {each.name} has members itself; list those in its place"
            )
    return members


def evaluation_config(
    policy: TrainConfig, suite: SuiteConfig | None, overrides: Sequence[str] = (), variant: Sequence[str] = ()
) -> TrainConfig:
    """Compose the settings that a policy is evaluated in.

    1. Without a suite they are those of the policy's training. With a suite they are those of the suite's stage, except
       for what belongs to the policy: robot, observation, network, control rate (``physics.timestep`` and
       ``physics.substeps``), and ``command`` if the policy was trained without commands and the task's success does not
       depend on them.
    2. Engine, device, engine memory, threads and number of worlds are this machine's defaults, not the training's.
    3. The overrides of the suite, the variant and the user come last, one setting at a time: ``start.x=[0,1]`` changes
       that value only, ``board=longboard`` changes the whole group. The user's overrides win.

    Args:
        policy: Settings of the policy's training.
        suite: A suite with a stage, or None.
        overrides: The user's overrides in Hydra's syntax, without settings of the command itself.
        variant: Overrides of a variant of the suite.

    Returns:
        New settings; ``policy`` is not changed.

    Raises:
        ConfigError: A setting is unknown, or an override would replace the policy's stage, task or experiment.
    """
    for override in overrides:
        if (instead := _INSTEAD.get(key := _key(override))) is not None:
            raise ConfigError(f"{override}: a policy has its own {key}; give {instead} instead")
    stage = policy.stage.name if suite is None else suite.stage
    # The policy's stage may not exist in this version.
    known = suite is not None or stage in choices("stage")
    changes = [] if suite is None else [*suite.overrides, *variant]
    theirs = {_key(o) for o in overrides}
    changes = [*(o for o in changes if _key(o) not in theirs), *overrides]
    asked = configuration.to_dict(configuration.compose(stage if known else None, ["curriculum=none", *changes]))

    result = copy.deepcopy(policy if suite is None else _stage(stage))
    result.robot, result.observation, result.network = policy.robot, policy.observation, policy.network
    result.physics.timestep, result.physics.substeps = policy.physics.timestep, policy.physics.substeps
    if policy.command.mode == "zero" and not TASKS.get(result.success).uses_command:
        result.command = policy.command
    values = configuration.to_dict(result)
    values["physics"] |= {name: asked["physics"][name] for name in _MACHINE}
    values["physics"]["num_worlds"] = NUM_WORLDS
    for override in changes:
        _copy(_key(override).replace("/", ".").split("."), asked, values)
    # The policy's observation may need other plugins than the suite's stage.
    values["plugins"] = list(dict.fromkeys([*policy.plugins, *result.plugins, *asked["plugins"]]))
    return configuration.from_dict(values)


def _stage(name: str) -> TrainConfig:
    """Compose a stage's settings without a curriculum; Hydra's work is cached, as many suites share a stage."""
    return configuration.compose(name, ["curriculum=none"])


def _key(override: str) -> str:
    """Return the setting or group that an override changes."""
    return OverridesParser.create().parse_override(override).key_or_group


def _copy(path: list[str], source: dict[str, Any], target: dict[str, Any]) -> None:
    """Copy one entry from source to target, or delete it if the source has none."""
    *parents, last = path
    for name in parents:
        source, target = source.get(name, {}), target.setdefault(name, {})
    if last in source:
        target[last] = copy.deepcopy(source[last])
    else:
        target.pop(last, None)
