"""Which task a policy is evaluated in."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser

from skatemount import config as configuration
from skatemount.agent import Agent, check_contract
from skatemount.benchmark.evaluation import NUM_WORLDS
from skatemount.config import Config
from skatemount.envs.task import MountTask
from skatemount.errors import ConfigError

NOT_THE_TASKS = ("checkpoint", "suite", "episodes", "json", "output", "seed")
"""Settings of the verbs themselves."""


@dataclass
class Trial:
    """A policy and the task to try it in.

    Attributes:
        agent: The policy.
        suite: Name of the stage whose task it is.
        config: The task's configuration.
        overrides: What the user changed in it.
    """

    agent: Agent
    suite: str
    config: Config
    overrides: list[str]

    @classmethod
    def prepare(cls, config: Config, overrides: Sequence[str]) -> Trial:
        """Load the policy that the command line names, and work out its task.

        Args:
            config: As composed from the command line; its ``checkpoint``, ``suite`` and ``logger.root`` count.
            overrides: What the user asked for; see `trial_config`.

        Raises:
            ConfigError: No such policy or suite, or the policy does not fit the task.
        """
        if config.suite is not None:
            check_suite(config.suite)
        agent = Agent.load(config.checkpoint, config.logger.root)
        asked = [o for o in overrides if _key(o) not in NOT_THE_TASKS]
        task = trial_config(agent.config, config.suite, asked)
        check_contract(agent.card, MountTask(config=task), f"checkpoint={config.checkpoint}")
        return cls(agent, config.suite or agent.card.stage or "its own task", task, asked)

    def describe(self) -> dict[str, Any]:
        """What is tried, as plain values."""
        card = self.agent.card
        return {
            "checkpoint": self.agent.name,
            "stage": card.stage,
            "suite": self.suite,
            "overrides": self.overrides,
            "frames": card.frames,
            "sha256": card.sha256,
        }


def check_suite(name: str) -> None:
    """Raise `ConfigError` unless there is a suite of that name: every stage is one."""
    known = configuration.stages()
    if name not in known:
        raise ConfigError(f"suite={name} is not a suite; there are: {', '.join(known)}")


def trial_config(policy: Config, suite: str | None, overrides: Sequence[str] = ()) -> Config:
    """The configuration that a policy is tried in.

    1. Without a suite it is the one that the policy was trained in. With one it is that stage's, but what belongs to
       the policy stays as in its training: robot, observation, network, control rate (``physics.timestep`` and
       ``physics.substeps``), and ``command`` if it was switched off there.
    2. Engine, threads and number of worlds belong to the machine that evaluates: the defaults of here, not of the
       training.
    3. On top of both comes what the user asks for, setting by setting: ``start.x=[0,1]`` changes that value alone, and
       ``board=longboard`` the whole group, as it is composed in that stage.

    Args:
        policy: The policy's own configuration.
        suite: Name of a stage, or none.
        overrides: In Hydra's syntax, without the verbs' own settings.

    Returns:
        A configuration of its own.

    Raises:
        ConfigError: An unknown suite or setting, or an override that stands for more than one group.
    """
    for override in overrides:
        if (key := _key(override)) in ("stage", "experiment"):
            instead = "suite=<name>" if key == "stage" else "the settings themselves"
            raise ConfigError(f"{override}: a policy brings its own {key}; give {instead} instead")
    if suite is not None:
        check_suite(suite)
    stage = suite or policy.stage.name
    # A policy may come from a stage that is not there any more.
    known = stage in configuration.stages()
    asked = configuration.to_dict(configuration.compose(stage if known else None, overrides))

    result = copy.deepcopy(policy) if suite is None else configuration.compose(suite)
    result.robot, result.observation, result.network = policy.robot, policy.observation, policy.network
    result.physics.timestep, result.physics.substeps = policy.physics.timestep, policy.physics.substeps
    if policy.command.mode == "zero":
        result.command = policy.command
    values = configuration.to_dict(result)
    values["physics"] |= {name: asked["physics"][name] for name in ("engine", "threads")}
    values["physics"]["num_worlds"] = NUM_WORLDS
    for override in overrides:
        _copy(_key(override).replace("/", ".").split("."), asked, values)
    return configuration.from_dict(values)


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
