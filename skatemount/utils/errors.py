"""Errors that name the setting, its value and what would be right."""

from __future__ import annotations

import math
from collections.abc import Sequence


class ConfigError(ValueError):
    """A setting has a value that cannot be used.

    The message is one line: it names the setting, the value it has, and the values that would do.
    """


def check_range(where: str, value: Sequence[float]) -> None:
    """Raise `ConfigError` unless a setting is a range to draw from.

    Args:
        where: The setting's name.
        value: ``[low, high]``.
    """
    if not (len(value) == 2 and value[0] <= value[1] and all(math.isfinite(bound) for bound in value)):
        raise ConfigError(f"{where}={value} must be a range [low, high] with low <= high")
