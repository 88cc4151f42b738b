"""The user's own YAML files (``--config-dir``): what is wrong with one of them, and in which line."""

from __future__ import annotations

import functools
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import yaml

from skatemount.config.files import (
    LAYERS,
    before_tasks,
    choices,
    config_dir,
    config_dirs,
    groups,
    no_choice,
    user_config_dir,
)
from skatemount.utils.documents import read_yaml
from skatemount.utils.errors import ConfigError

_PACKAGE = re.compile(r"#\s*@package\s+(\S+)")
_KEY = re.compile(r"([\w.-]+?)(=|:| )")
_IN_FILE = re.compile(r"In '([\w./-]+)'")
_ENTRY = re.compile(r"(?P<words>((override|optional)\s+)*)(?P<slash>/?)(?P<path>[\w-]+(/[\w-]+)*)")


def check_own_files(overrides: Sequence[str]) -> None:
    """Check the user's files that a composition reads: YAML mappings whose defaults lists name what there is.

    Args:
        overrides: Settings of a command line; ``stage=mine,other`` reads both.

    Raises:
        ConfigError: A file cannot be used; the message names it and the line.
    """
    own = {(group, path.stem): path for group, path in own_files()}
    if not own:
        return
    asked = [each.lstrip("+").partition("=") for each in overrides]
    names = [(group.partition("@")[0], name.strip("'\"[] ")) for group, _, value in asked for name in value.split(",")]
    done = set()
    while names:
        each = names.pop()
        if each in own and each not in done:
            done.add(each)
            check_own_file(each[0], own[each])
            names += _included(each[0], own[each])


def check_own_file(group: str, path: Path) -> None:
    """Check one file of the user's; see `check_own_files`.

    Args:
        group: The group that the file belongs to.
        path: The file.
    """
    node = _node(path, path.stat().st_mtime_ns)
    if group == "search" and not any(key.value == "defaults" for key, _ in node.value):
        # What the file does not set would be missing, and Hydra would name only that.
        raise ConfigError(f"{path} lacks `defaults: [default, _self_]`")
    for key, value in node.value:
        if key.value != "defaults":
            continue
        if not isinstance(value, yaml.SequenceNode):
            raise ConfigError(f"{_at(path, value)}: defaults must be a list, such as [default, _self_]")
        for entry in value.value:
            if problem := _problem(group, entry):
                raise ConfigError(f"{_at(path, entry)}: {problem}")
    if circle := _circle(group, path.stem, []):
        raise ConfigError(f"{path}: includes itself through its defaults list: {' > '.join(circle)}")


def _included(group: str, path: Path) -> list[tuple[str, str]]:
    """Return the files in the defaults list of a file that is checked already, each as its group and name."""
    found: list[tuple[str, str]] = []
    for entry in read_yaml(path).get("defaults") or []:
        if isinstance(entry, str):
            above, _, name = entry.rpartition("/")
            found.append((above.lstrip("/") or group, name))
        else:
            found += [(key.split()[-1].lstrip("/").partition("@")[0], str(name)) for key, name in entry.items()]
    return found


def own_files() -> Iterator[tuple[str, Path]]:
    """Yield the files of the user's groups, each with its group."""
    folder = user_config_dir()
    if folder is None:
        return
    for group in groups():
        for path in sorted((folder / group).glob("*.yaml")):
            yield group, path


def with_place(error: ConfigError, values: dict[str, Any]) -> ConfigError:
    """Return an error about composed settings, with the user's file and the line that the setting comes from.

    Args:
        error: An error whose message begins with the setting.
        values: The composed settings, nested.

    Returns:
        The same error if no file of the user's gives that setting its value.
    """
    message = str(error)
    if user_config_dir() is None or (match := _KEY.match(message)) is None:
        return error
    wanted = match[1].split(".")
    for group, path in own_files():
        package = _package(group, path)
        if wanted[: len(package)] != package:
            continue
        found = _line_of(path, wanted[len(package) :], _value(values, wanted))
        if found is not None:
            hint = ""
            if package and all(_package(group, each) == [] for each in (config_dir() / group).glob("*.yaml")):
                hint = f"; a file of the group {group} begins with the line # @package _global_"
            return ConfigError(f"{path}, line {found}: {message}{hint}")
    return error


def with_path(message: str) -> str:
    """Return a message of Hydra with the user's file in place of its name, as in ``In 'stage/mine'``."""

    def path(match: re.Match[str]) -> str:
        group, _, name = match[1].rpartition("/")
        found = {(group, path.stem): path for group, path in own_files()}.get((group, name))
        return match[0] if found is None else str(found)

    return _IN_FILE.sub(path, message)


@functools.lru_cache(maxsize=1024)
def _node(path: Path, changed: int) -> yaml.MappingNode:
    """Return the nodes of a file, which know their lines.

    Args:
        path: The file.
        changed: When it was changed, so that it is read again afterwards.
    """
    # Before anything follows its aliases.
    read_yaml(path)
    node = yaml.compose(path.read_text(encoding="utf-8"), yaml.SafeLoader)
    assert isinstance(node, yaml.MappingNode)
    _check_twice(path, node)
    return node


def _check_twice(path: Path, node: yaml.Node) -> None:
    """Raise `ConfigError` for a key that a mapping has twice; Hydra refuses it with a traceback."""
    if isinstance(node, yaml.MappingNode):
        seen: set[str] = set()
        for key, value in node.value:
            if isinstance(key, yaml.ScalarNode):
                if key.value in seen:
                    raise ConfigError(f"{_at(path, key)}: {key.value} is there twice")
                seen.add(key.value)
            _check_twice(path, value)
    elif isinstance(node, yaml.SequenceNode):
        for value in node.value:
            _check_twice(path, value)


def _at(path: Path, node: yaml.Node) -> str:
    return f"{path}, line {node.start_mark.line + 1}"


def _problem(group: str, entry: yaml.Node) -> str | None:
    """Return what is wrong with an entry of a defaults list; None if nothing is, or only Hydra can tell.

    Args:
        group: The group of the file.
        entry: The entry.
    """
    example = "an entry of defaults is a name, or such as override /board: default"
    if isinstance(entry, yaml.ScalarNode):
        name = entry.value
        if entry.tag != "tag:yaml.org,2002:str":
            return f"{name}: {example}"
        if re.fullmatch(r"[\w-]+", name) and name != "_self_" and name not in choices(group):
            return no_choice(group, name)
        return None
    if not isinstance(entry, yaml.MappingNode) or len(entry.value) != 1:
        return example
    key, value = entry.value[0]
    if isinstance(value, yaml.MappingNode):
        return f"{key.value}: {example}"
    match = _ENTRY.fullmatch(key.value)
    if match is None or match["path"].startswith("hydra"):
        return None
    wanted = match["path"]
    if isinstance(value, yaml.SequenceNode) and wanted not in LAYERS and len(value.value) != 1:
        return f"{key.value}: takes one name; of a list, the last would win"
    if not isinstance(value, yaml.ScalarNode):
        return None
    name = value.value
    if wanted not in groups():
        return f"{key.value}: there is no group {wanted}; groups are {', '.join(groups())}"
    if not match["slash"]:
        return f"{key.value}: write /{wanted} for the group {wanted}"
    if "override" in match["words"] and group == "task" and wanted not in (known := before_tasks()):
        return f"{key.value}: a task can override only {', '.join(known)}"
    if value.tag == "tag:yaml.org,2002:null" or "optional" in match["words"] or "${" in name:
        return None
    return None if name in choices(wanted) else f"{key.value}: {no_choice(wanted, name)}"


def _circle(group: str, name: str, before: list[str]) -> list[str] | None:
    """Return the files of a group that include each other in a circle, beginning with one; None if none does."""
    if name in before:
        return [*before[before.index(name) :], name]
    for folder in config_dirs()[1:]:
        if (path := folder / group / f"{name}.yaml").is_file():
            entries = read_yaml(path).get("defaults") or []
            for entry in entries if isinstance(entries, list) else []:
                if isinstance(entry, str) and (found := _circle(group, entry, [*before, name])):
                    return found
    return None


def _package(group: str, path: Path) -> list[str]:
    """Return the keys above a file's settings: its group, unless its first lines say otherwise."""
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        if not line.startswith("#"):
            break
        if match := _PACKAGE.match(line):
            name = match[1].replace("_group_", group)
            return [] if name == "_global_" else name.split(".")
    return group.split("/")


def _value(values: Any, keys: list[str]) -> Any:
    for key in keys:
        values = values.get(key) if isinstance(values, dict) else None
    return values


def _line_of(path: Path, keys: list[str], value: Any) -> int | None:
    """Return the line in which a file gives a setting its value; None if it does not.

    Args:
        path: The file.
        keys: Keys of the setting below the file's package; none for the package itself.
        value: The composed value.
    """
    try:
        node: yaml.Node = _node(path, path.stat().st_mtime_ns)
        there = read_yaml(path)
    except ConfigError:
        return None
    if not keys:
        said = {key: each for key, each in there.items() if key != "defaults"}
        return node.start_mark.line + 1 if isinstance(value, dict) and said.items() <= value.items() else None
    if _value(there, keys) != value:
        return None
    line = None
    for key in keys:
        pairs = node.value if isinstance(node, yaml.MappingNode) else []
        found = next(((k, v) for k, v in pairs if k.value == key), None)
        if found is None:
            return None
        line, node = found[0].start_mark.line + 1, found[1]
    return line
