"""YAML files that may come from elsewhere: plain data, of a size that can be used."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from skatemount.utils.errors import ConfigError

MAX_BYTES = 16_000_000
MAX_VALUES = 200_000
"""Largest number of values of a document once its aliases are filled in; a run's settings have about 400."""


def read_yaml(path: Path) -> dict[str, Any]:
    """Return the mapping in a YAML file.

    Raises:
        ConfigError: The file cannot be read, is not a YAML mapping, or is too large; the message names it.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from error
    if len(data) > MAX_BYTES:
        raise ConfigError(f"{path}: has {len(data)} bytes; settings have at most {MAX_BYTES}")
    try:
        values = yaml.safe_load(data.decode("utf-8"))
    except yaml.MarkedYAMLError as error:
        raise ConfigError(f"{path}{_line(error)}: not plain YAML ({_problem(error)})") from error
    except (yaml.YAMLError, UnicodeDecodeError, ValueError, RecursionError) as error:
        raise ConfigError(f"{path}: not plain YAML ({' '.join(str(error).split())[:300]})") from error
    if not isinstance(values, dict):
        found = "nothing" if values is None else f"a {type(values).__name__}"
        raise ConfigError(f"{path}: holds {found}, a mapping is needed")
    check_size(values, str(path))
    return values


def _line(error: yaml.MarkedYAMLError) -> str:
    mark = error.problem_mark or error.context_mark
    return "" if mark is None else f", line {mark.line + 1}"


def _problem(error: yaml.MarkedYAMLError) -> str:
    """Return what a YAML error says, without the text around it."""
    said = " ".join(f"{error.context or ''} {error.problem or ''}".split())
    begun = error.context_mark
    if begun is not None and error.problem_mark is not None and begun.line != error.problem_mark.line:
        said += f", begun in line {begun.line + 1}"
    return said[:300]


def check_size(values: Any, where: str) -> None:
    """Check that nested values stay small when their aliases are filled in, and do not contain themselves.

    Aliases take no memory until somebody copies the values: ten lines can stand for a billion values.

    Args:
        values: Nested dicts and lists.
        where: Name of the document, for messages.

    Raises:
        ConfigError: They contain themselves, or are more than `MAX_VALUES`.
    """
    if _count(values, {}, where) > MAX_VALUES:
        raise ConfigError(f"{where}: its aliases stand for more than {MAX_VALUES} values")


def _count(value: Any, known: dict[int, int | None], where: str, depth: int = 0) -> int:
    """Return the number of values in a document.

    Args:
        value: The document, or a part of it.
        known: Numbers of the parts that were counted already, by `id`; None while a part is being counted.
        where: Name of the document, for messages.
        depth: Depth of the part.
    """
    if not isinstance(value, dict | list):
        return 1
    if id(value) in known:
        counted = known[id(value)]
        if counted is None:
            raise ConfigError(f"{where}: contains itself through an alias")
        return counted
    if depth > 100:
        raise ConfigError(f"{where}: is nested deeper than 100 levels")
    known[id(value)] = None
    parts = value.values() if isinstance(value, dict) else value
    total = 1 + sum(_count(part, known, where, depth + 1) for part in parts)
    known[id(value)] = total
    return total
