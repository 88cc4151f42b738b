"""The YAML files of the settings."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import yaml

import skatemount
from skatemount.utils.errors import ConfigError

SHARED = "base"
"""Folder of what the programs' files have in common; it is no group."""


@functools.cache
def config_dir() -> Path:
    """Return the folder of the YAML groups: inside the package in a wheel, beside it in a clone."""
    package = Path(skatemount.__file__).parent
    for folder in (package / "conf", package.parent / "conf"):
        if (folder / "train.yaml").is_file():
            return folder
    raise ConfigError(f"no settings found in or beside {package}: install skatemount again")


def groups(program: str | None = None) -> list[str]:
    """Return the names of the groups of settings.

    Args:
        program: Leave out the groups that this program does not have.
    """
    found = sorted(path.name for path in config_dir().iterdir() if path.is_dir() and path.name != SHARED)
    if program is None:
        return found
    return [name for name in found if name in _listed(program)]


def choices(group: str) -> list[str]:
    """Return the names of a group's files."""
    return sorted(path.stem for path in (config_dir() / group).glob("*.yaml"))


def load_file(group: str, name: str) -> dict[str, Any]:
    """Return what a group's file says, without composing it with others.

    Raises:
        ConfigError: There is no such file, or it is not a YAML mapping.
    """
    path = config_dir() / group / f"{name}.yaml"
    check_choice(group, name)
    try:
        values = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not YAML ({' '.join(str(error).split())})") from error
    if not isinstance(values, dict):
        raise ConfigError(f"{path}: holds a {type(values).__name__}, a mapping is needed")
    return values


def stages() -> dict[str, str]:
    """Return every stage with its one-line description."""
    return _described("stage", "stage.description")


def suites() -> dict[str, str]:
    """Return every suite with its one-line description."""
    return _described("suite", "description")


def check_choice(group: str, name: str) -> None:
    """Raise `ConfigError` unless a group has a file of that name."""
    if name not in choices(group):
        raise ConfigError(f"{group}={name}: there is no {group} {name}; there are: {', '.join(choices(group))}")


def _described(group: str, key: str) -> dict[str, str]:
    found = {}
    for name in choices(group):
        value: Any = load_file(group, name)
        for part in key.split("."):
            value = value.get(part) or {}
        found[name] = str(value or "")
    return found


def _listed(program: str) -> set[str]:
    """Return the groups in a program's defaults list, with those of the files that it includes."""
    found: set[str] = set()
    files = [f"{program}"]
    while files:
        path = config_dir() / f"{files.pop()}.yaml"
        for entry in yaml.safe_load(path.read_text(encoding="utf-8")).get("defaults", []):
            if isinstance(entry, str) and entry != "_self_":
                files.append(entry if "/" in entry else f"{SHARED}/{entry}")
            elif isinstance(entry, dict):
                found |= {key.lstrip("/") for key in entry if not key.startswith("override")}
    return found
