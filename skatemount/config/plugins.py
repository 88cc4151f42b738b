"""Plugins: modules of the user that register terms, commands, curricula, robots, networks, losses and so on.

`plugins=[my_package.terms]` imports them before the names that they register are checked, and so does a setting that
names a class, `network.kind=my_package.nets:Mine`. Saved settings name both, but only a run of one's own imports them
by itself: a policy from elsewhere must not run code.
"""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Mapping, Sequence
from typing import Any

from skatemount.config.registries import POLICY_CLASSES, TRAINING_CLASSES, adopt, class_names, registries
from skatemount.envs.config.task import TaskConfig
from skatemount.utils.classes import module_of
from skatemount.utils.errors import ConfigError, place_of

_NAME = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*")


def import_plugins(plugins: Sequence[str]) -> None:
    """Import plugins, and check what they register.

    A plugin that fails registers nothing.

    Args:
        plugins: Dotted names of modules.

    Raises:
        ConfigError: A plugin cannot be imported, or something that it registers cannot be used; the message names both.
    """
    for name in plugins:
        check_name(name)
        if name not in sys.modules:
            _import(name, written([name]))


def import_classes(config: TaskConfig, training: bool = True) -> None:
    """Import the modules of the classes that settings name as ``module:Class``, and check the classes.

    Args:
        config: The settings.
        training: Import those that only a training needs as well.

    Raises:
        ConfigError: A module cannot be imported, or it has no such class; the message names the setting.
    """
    for setting, name in _classes(config, training):
        registry = (POLICY_CLASSES | TRAINING_CLASSES)[setting]
        registry.check_name(name, setting)
        if (module := module_of(name)) not in sys.modules:
            _import(module, f"{setting}={name}")
        registry.find(name, setting)


def require_plugins(plugins: Sequence[str], where: str) -> None:
    """Raise `ConfigError` unless plugins are imported already.

    Args:
        plugins: Dotted names of modules.
        where: Name of the settings that name them, for the message.
    """
    for name in plugins:
        check_name(name)
    if missing := [name for name in plugins if name not in sys.modules]:
        raise ConfigError(
            f"{where}: {written(missing)} are imported by themselves only for a run inside logger.root; repeat "
            f"{written(plugins)} if you trust them"
        )


def require_classes(config: TaskConfig, where: str, training: bool = True) -> None:
    """Raise `ConfigError` unless the classes that settings name are there without importing a module.

    Args:
        config: The settings.
        where: Name of the settings, for the message.
        training: Require those that only a training needs as well.
    """
    for setting, name in _classes(config, training):
        (POLICY_CLASSES | TRAINING_CLASSES)[setting].find(name, f"{where}: {setting}")


def modules_of(config: TaskConfig | Mapping[str, Any], training: bool = True) -> list[str]:
    """Return the modules of the user that settings need: the plugins, then those of the classes that they name.

    Args:
        config: The settings, as dataclasses or as plain values.
        training: Return those that only a training needs as well.
    """
    plugins = config.get("plugins") or [] if isinstance(config, Mapping) else config.plugins
    return list(dict.fromkeys([*plugins, *(module_of(name) for _, name in _classes(config, training))]))


def _classes(config: TaskConfig | Mapping[str, Any], training: bool) -> list[tuple[str, str]]:
    return class_names(config, POLICY_CLASSES | TRAINING_CLASSES if training else POLICY_CLASSES)


def check_name(name: str) -> None:
    """Raise `ConfigError` for a name that no module can have."""
    if not _NAME.fullmatch(name):
        raise ConfigError(f"plugins=[{name}]: must be the dotted name of a module, such as my_package.terms")


def written(plugins: Sequence[str]) -> str:
    """Return plugins as on a command line."""
    return f"plugins=[{','.join(plugins)}]"


def _import(name: str, where: str) -> None:
    """Import a module of the user; `where` is the setting that names it."""
    known = registries()
    before = [registry.snapshot() for registry in known]
    modules = set(sys.modules)
    try:
        importlib.import_module(name)
        for registry in known:
            registry.check()
        adopt(name)
    except (Exception, SystemExit) as error:
        for registry, saved in zip(known, before):
            registry.restore(saved)
        # Otherwise the next import would find the modules, but not what they register.
        top = name.partition(".")[0]
        for module in set(sys.modules) - modules:
            if module.partition(".")[0] == top:
                del sys.modules[module]
        raise ConfigError(f"{where}: {_reason(name, error)}") from error


def _reason(name: str, error: BaseException) -> str:
    """Return in one line why an import failed."""
    text = " ".join(str(error).split())
    if isinstance(error, ConfigError):
        return text
    if isinstance(error, ModuleNotFoundError) and error.name and f"{name}.".startswith(f"{error.name}."):
        return f"there is no module {error.name}; install it, or put its folder on PYTHONPATH"
    if isinstance(error, SyntaxError):
        text = error.msg
    return f"cannot be imported: {type(error).__name__}: {text}{place_of(error)}"
