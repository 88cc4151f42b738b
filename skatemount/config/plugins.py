"""Plugins: modules of the user that register rewards, observations and terminations of their own.

`plugins=[my_package.terms]` imports them before the names of terms are checked. Saved settings name their plugins, but
only a run of one's own imports them by itself: a policy from elsewhere must not run code.
"""

from __future__ import annotations

import importlib
import re
import sys
import traceback
from collections.abc import Sequence

from skatemount.utils.errors import ConfigError

_NAME = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*")


def import_plugins(plugins: Sequence[str]) -> None:
    """Import plugins, and check the terms that they register.

    A plugin that fails registers nothing.

    Args:
        plugins: Dotted names of modules.

    Raises:
        ConfigError: A plugin cannot be imported, or one of its terms cannot be used; the message names both.
    """
    for name in plugins:
        check_name(name)
        if name not in sys.modules:
            _import(name)


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


def check_name(name: str) -> None:
    """Raise `ConfigError` for a name that no module can have."""
    if not _NAME.fullmatch(name):
        raise ConfigError(f"plugins=[{name}]: must be the dotted name of a module, such as my_package.terms")


def written(plugins: Sequence[str]) -> str:
    """Return plugins as on a command line."""
    return f"plugins=[{','.join(plugins)}]"


def _import(name: str) -> None:
    # Imported here because the terms need torch, which takes seconds to import.
    from skatemount.envs.observations import OBSERVATIONS
    from skatemount.envs.rewards import REWARDS
    from skatemount.envs.terminations import TERMINATIONS

    registries = (REWARDS, OBSERVATIONS, TERMINATIONS)
    before = [registry.snapshot() for registry in registries]
    modules = set(sys.modules)
    try:
        importlib.import_module(name)
        for registry in registries:
            registry.check()
    except (Exception, SystemExit) as error:
        for registry, saved in zip(registries, before):
            registry.restore(saved)
        # Otherwise the next import would find the modules, but not their terms.
        top = name.partition(".")[0]
        for module in set(sys.modules) - modules:
            if module.partition(".")[0] == top:
                del sys.modules[module]
        raise ConfigError(f"{written([name])}: {_reason(name, error)}") from error


def _reason(name: str, error: BaseException) -> str:
    """Return in one line why an import failed."""
    text = " ".join(str(error).split())
    if isinstance(error, ConfigError):
        return text
    if isinstance(error, ModuleNotFoundError) and error.name and f"{name}.".startswith(f"{error.name}."):
        return f"there is no module {error.name}; install it, or put its folder on PYTHONPATH"
    place = ""
    if frames := traceback.extract_tb(error.__traceback__):
        place = f" ({frames[-1].filename}, line {frames[-1].lineno})"
    return f"cannot be imported: {type(error).__name__}: {text}{place}"
