"""`skatemount list <kind>`: the stages, suites, robots, boards, policies, terms and classes that there are."""

from __future__ import annotations

import difflib
import json
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import yaml

from skatemount import config as configuration
from skatemount.cli import config_dir_of
from skatemount.config import TrainConfig
from skatemount.config.files import choices, find_file, robot_of
from skatemount.config.own_files import check_own_file, own_files
from skatemount.config.plugins import import_plugins
from skatemount.config.registries import ALGORITHMS, CALLBACKS, COMMANDS, CURRICULA, LOGGERS, NETWORKS
from skatemount.envs.robots import ROBOTS
from skatemount.runs.shipped import ALIASES, PRETRAINED, shipped_file, shipped_policies
from skatemount.utils.classes import ClassRegistry
from skatemount.utils.errors import ConfigError
from skatemount.utils.formatting import format_count
from skatemount.utils.quiet import ignore_library_warnings
from skatemount.utils.terminal import safe_streams


def _of_group(group: str) -> dict[str, str]:
    """Return a group's choices with the first sentence of each file's comment, or with what is wrong with the file."""
    return {name: _comment(find_file(group, name)) for name in choices(group)} | _broken(group)


def _comment(path: Path) -> str:
    """Return the first sentence of the comment at the top of a file."""
    lines = []
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        if not line.startswith("#"):
            break
        if not line.startswith("# @package"):
            lines.append(line.lstrip("# "))
    return re.split(r"(?<=[.:])\s", " ".join(lines))[0].rstrip(".:")


def _broken(group: str) -> dict[str, str]:
    """Return the files of the user's in a group that cannot be used, each with the reason."""
    found = {}
    for path in (path for its_group, path in own_files() if its_group == group):
        try:
            check_own_file(group, path)
            configuration.compose_program("evaluate" if group == "suite" else "train", [f"{group}={path.stem}"])
        except ConfigError as error:
            found[path.stem] = f"broken: {error}"
    return found


def _tasks() -> dict[str, str]:
    """Return the files of the group, then the tasks of plugins that have no file."""
    from skatemount.envs.tasks import TASKS

    files = _of_group("task")
    return files | {f"success={name}": TASKS.description(name) for name in TASKS.names() if name not in files}


def _robots() -> dict[str, str]:
    """Return the files of the group with the robots' masses, then the robots of plugins that have no file."""
    files, broken = _of_group("robot"), _broken("robot")
    variants = {name: robot_of(name) for name in files if name not in broken}
    for name, variant in variants.items():
        if variant in ROBOTS and " kg" not in files[name]:
            files[name] = ", ".join(filter(None, [files[name], f"{ROBOTS[variant].mass:.3f} kg"]))
    others = [name for name in ROBOTS if name not in variants.values()]
    return files | {f"robot.variant={name}": f"{ROBOTS[name].mass:.3f} kg" for name in others}


def _policies() -> dict[str, str]:
    """Return the shipped policies with the length, the stage and the initial policy of their training."""
    found = {}
    for name in shipped_policies():
        file = shipped_file(name.removeprefix(PRETRAINED))
        assert file is not None
        card = json.loads(file.with_suffix(".json").read_text(encoding="utf-8"))
        config = card["config"]
        first = config["init_from"] if config["init_from"] != "stage" else config["stage"]["init_from"]
        first = "scratch" if first is None else _today(first)
        found[name] = f"{format_count(card['frames'])} steps in stage {config['stage']['name']}, from {first}"
        if note := _NOTES.get(name):
            found[name] += f"; {note}"
    return found


_NOTES = {"pretrained:anywhere": "with the settings, given one by one, that stage anywhere has since"}
"""Remarks on policies that their cards do not contain."""


def _today(name: str) -> str:
    """Return the present name of a shipped policy."""
    old = name.removeprefix(PRETRAINED)
    return f"{PRETRAINED}{ALIASES.get(old, old)}"


def _rewards() -> dict[str, str]:
    from skatemount.envs.rewards import REWARDS

    return {name: REWARDS.description(name) for name in REWARDS.names()}


def _observations() -> dict[str, str]:
    from skatemount.envs.observations import OBSERVATIONS

    return {name: OBSERVATIONS.description(name) for name in OBSERVATIONS.names()}


def _terminations() -> dict[str, str]:
    from skatemount.envs.terminations import TERMINATIONS

    return {name: TERMINATIONS.description(name) for name in TERMINATIONS.names()}


def _terms_of(kind: str, config: TrainConfig) -> dict[str, str]:
    """Return the terms that settings use, with their settings.

    Args:
        kind: ``rewards``, ``observations`` or ``terminations``.
        config: The settings.
    """
    if kind == "rewards":
        return {name: f"weight {term.weight:g}{_params(term)}" for name, term in config.reward.items() if term.weight}
    if kind == "terminations":
        return {name: f"enabled{_params(term)}" for name, term in config.termination.items() if term.enabled}
    policy, privileged = config.observation.policy, config.observation.privileged
    return {name: f"for the policy{_params(term)}" for name, term in policy.items()} | {
        name: f"for the policy and the critic{_params(term)}" if name in policy else f"for the critic{_params(term)}"
        for name, term in privileged.items()
    }


def _params(term: Any) -> str:
    return "".join(f", {name}={value}" for name, value in term.params.items())


def _classes(registry: ClassRegistry, prefix: str = "") -> dict[str, str]:
    """Return the registered classes with the first line of each one's docstring.

    Args:
        registry: The classes.
        prefix: Text before each name, to tell classes from the files of a group.
    """
    return {f"{prefix}{name}": registry.description(name) for name in registry.names()}


def _group_and_classes(group: str, registry: ClassRegistry, setting: str = "kind") -> dict[str, str]:
    """Return a group's files and its classes."""
    return _of_group(group) | _classes(registry, f"{setting}=")


KINDS: dict[str, tuple[str, Callable[[], dict[str, str]]]] = {
    "stages": ("what to train: stage=<name>", lambda: configuration.stages() | _broken("stage")),
    "tasks": ("what an episode is about: task=<name>", _tasks),
    "suites": ("tests of MountBench: suite=<name>", lambda: configuration.suites() | _broken("suite")),
    "robots": ("robot=<name>", _robots),
    "boards": ("board=<name>", lambda: _of_group("board")),
    "policies": ("shipped policies: checkpoint=<name>, init_from=<name>", _policies),
    "rewards": ("terms: reward.<name>.weight=<size>", _rewards),
    "observations": ("terms: observation.policy.<name>={}", _observations),
    "terminations": ("terms: termination.<name>={}", _terminations),
    "commands": (
        "velocity commands: command=<name>; classes: command.mode=<name>",
        lambda: _group_and_classes("command", COMMANDS, "mode"),
    ),
    "curricula": (
        "order of the start states: curriculum=<name>; classes: curriculum.kind=<name>",
        lambda: _group_and_classes("curriculum", CURRICULA),
    ),
    "networks": (
        "network=<name>; classes: network.kind=<name>",
        lambda: _group_and_classes("network", NETWORKS),
    ),
    "algorithms": (
        "algorithm=<name>; classes: algorithm.kind=<name>",
        lambda: _group_and_classes("algorithm", ALGORITHMS),
    ),
    "callbacks": ("in every training, except film; others: callbacks=[<name>]", lambda: _classes(CALLBACKS)),
    "loggers": (
        "tensorboard and jsonl: logger.<name>=true; others: logger.loggers=[<name>]",
        lambda: _classes(LOGGERS),
    ),
    "experiments": ("settings that belong together: experiment=<name>", lambda: _of_group("experiment")),
}
"""The kinds that can be listed: a line about each, and a function that returns its names with their descriptions."""


WITH_SETTINGS = ("rewards", "observations", "terminations")
"""The kinds that can be listed as a training with given settings uses them."""


def listed(arguments: Sequence[str]) -> str:
    """Return the table that a command line asks for.

    Args:
        arguments: The kind, and in any order ``--config-dir <folder>`` and ``plugins=[...]``; without a kind the table
            says what can be listed. With settings such as ``stage=balance``, rewards, observations and terminations
            are those that a training with these settings uses.

    Raises:
        ConfigError: An unknown kind, argument or setting, or a folder or plugin that cannot be used.
    """
    configuration.set_user_config_dir(config_dir_of(arguments))
    kinds, plugins, settings, is_value = [], [], [], False
    for argument in arguments:
        if is_value:
            is_value = False
        elif argument in ("--config-dir", "-cd"):
            is_value = True
        elif argument.startswith("plugins="):
            plugins = _plugins(argument)
        elif argument in KINDS:
            kinds.append(argument)
        elif "=" in argument and not argument.startswith("-"):
            settings.append(argument)
        elif not argument.startswith(("--config-dir=", "-cd=")) and argument not in ("--help", "-h"):
            close = difflib.get_close_matches(argument, KINDS, n=1)
            hint = f" (did you mean {close[0]}?)" if close else ""
            raise ConfigError(f"{argument} cannot be listed{hint}; there are: {', '.join(KINDS)}")
    import_plugins(plugins)
    if not kinds:
        return "skatemount list <kind>\n\n" + _table({name: about for name, (about, _) in KINDS.items()})
    if not settings:
        return "\n\n".join(_table(KINDS[kind][1]()) for kind in kinds)
    if others := [kind for kind in kinds if kind not in WITH_SETTINGS]:
        raise ConfigError(f"{settings[0]}: {others[0]} do not depend on settings, only {', '.join(WITH_SETTINGS)} do")
    config = configuration.compose(None, [*(each for each in arguments if each.startswith("plugins=")), *settings])
    return "\n\n".join(_table(_terms_of(kind, config)) for kind in kinds)


def _plugins(argument: str) -> list[str]:
    """Return the names in ``plugins=[...]``."""
    try:
        names = yaml.safe_load(argument.partition("=")[2])
    except yaml.YAMLError:
        names = None
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ConfigError(f"{argument} must be a list such as [a, b]")
    return names


def _table(rows: dict[str, str]) -> str:
    width = max(map(len, rows), default=0)
    return "\n".join(f"{name:{width}}  {about}".rstrip() for name, about in rows.items())


@safe_streams()
def main() -> None:
    """Run the program."""
    ignore_library_warnings()
    try:
        print(listed(sys.argv[1:]))
    except (ConfigError, OSError) as error:
        print(f"skatemount.list: {error}", file=sys.stderr)
        sys.exit(2)
