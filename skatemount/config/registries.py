"""Everything that a plugin can register, and the settings that name classes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from skatemount.curriculum.config import CURRICULA
from skatemount.envs.config.commands import COMMANDS
from skatemount.envs.config.task import TaskConfig
from skatemount.losses.config import ALGORITHMS
from skatemount.models.config import NETWORKS
from skatemount.runs.loggers import LOGGERS
from skatemount.utils.classes import ClassRegistry
from skatemount.utils.errors import ConfigError

HOOKS = (
    "on_train_start",
    "on_batch_collected",
    "on_iteration_end",
    "on_evaluation_end",
    "on_interrupt",
    "on_train_end",
)
"""Methods of a callback that a training calls."""

CALLBACKS = ClassRegistry(
    "callback",
    {
        name: f"skatemount.training.callbacks:{name.capitalize()}Callback"
        for name in ("curriculum", "evaluation", "logger", "checkpoint", "plot")
    }
    | {"film": "skatemount.training.film:FilmCallback"},
    methods=(*HOOKS, "state_dict", "load_state_dict"),
    base="skatemount.training.callbacks.Callback",
)
"""Callbacks by name; those of the package are in every training, except `film`."""

POLICY_CLASSES: dict[str, ClassRegistry] = {"network.kind": NETWORKS, "command.mode": COMMANDS}
"""Settings that name a class which a trained policy needs, and the classes that they may name."""

TRAINING_CLASSES: dict[str, ClassRegistry] = {
    "algorithm.kind": ALGORITHMS,
    "curriculum.kind": CURRICULA,
    "callbacks": CALLBACKS,
    "logger.loggers": LOGGERS,
}
"""Settings that name a class which only a training needs."""


class Registry(Protocol):
    """Things by name that a plugin can add to."""

    def snapshot(self) -> Any:
        """Return the present content, for `restore`."""

    def restore(self, saved: Any) -> None:
        """Go back to the content of a snapshot."""

    def check(self) -> None:
        """Raise `ConfigError` for something that cannot be used."""


class Table:
    """A dict that plugins add to with ``table[name] = value``, as a registry.

    Args:
        kind: What its values are, for messages.
        table: The dict, filled by the package.
    """

    def __init__(self, kind: str, table: dict[str, Any]) -> None:
        self._kind, self._table = kind, table
        self._known = dict(table)
        self._owners = dict.fromkeys(table, "skatemount")

    def snapshot(self) -> tuple[dict[str, Any], dict[str, str]]:
        """Return the present content, for `restore`."""
        return dict(self._table), dict(self._owners)

    def restore(self, saved: tuple[dict[str, Any], dict[str, str]]) -> None:
        """Go back to the content of a snapshot, in the same dict."""
        self._table.clear()
        self._table.update(saved[0])
        self._known, self._owners = dict(saved[0]), dict(saved[1])

    def adopt(self, plugin: str) -> None:
        """Note that a plugin added what is new.

        Raises:
            ConfigError: The plugin replaced something; the message names both places.
        """
        for name, value in self._table.items():
            if name in self._known and self._known[name] is not value:
                raise ConfigError(f"{self._kind} {name!r} is registered twice, by {self._owners[name]} and by {plugin}")
            self._owners.setdefault(name, plugin)
        self._known = dict(self._table)

    def check(self) -> None:
        """Check nothing: a value of a wrong kind is found when it is used."""


def class_names(config: TaskConfig | Mapping[str, Any], settings: Mapping[str, ClassRegistry]) -> list[tuple[str, str]]:
    """Return the settings that name a ``module:Class``, each with that name.

    Args:
        config: The settings of a program, as dataclasses or as plain values.
        settings: `POLICY_CLASSES`, `TRAINING_CLASSES` or both; those that the program does not have are left out.
    """
    found = []
    for setting in settings:
        value: Any = config
        for part in setting.split("."):
            value = value.get(part) if isinstance(value, Mapping) else getattr(value, part, None)
        names = value if isinstance(value, list) else [value]
        found += [(setting, name) for name in names if isinstance(name, str) and ":" in name]
    return found


_TABLES: dict[str, Table] = {}


def registries() -> list[Registry]:
    """Return everything that a plugin can register; imports torch, as the terms need it."""
    from skatemount.envs.observations import OBSERVATIONS
    from skatemount.envs.rewards import REWARDS
    from skatemount.envs.robots import ROBOTS
    from skatemount.envs.tasks import TASKS
    from skatemount.envs.terminations import TERMINATIONS

    tables = {"robot": ROBOTS}
    for kind, table in tables.items():
        if kind not in _TABLES:
            _TABLES[kind] = Table(kind, table)
    return [
        REWARDS,
        OBSERVATIONS,
        TERMINATIONS,
        TASKS,
        *POLICY_CLASSES.values(),
        *TRAINING_CLASSES.values(),
        *_TABLES.values(),
    ]


def adopt(plugin: str) -> None:
    """Note that a plugin added what is new in the tables that are dicts; see `Table.adopt`."""
    for table in _TABLES.values():
        table.adopt(plugin)
