"""Errors of settings, in one line that names the setting, its value and the values that are allowed."""

from __future__ import annotations

import math
from collections.abc import Sequence


class ConfigError(ValueError):
    """An error for a setting that has an unusable value.

    The message is one line. It names the setting, its value, and the values that are allowed.
    """


def check_range(where: str, value: Sequence[float]) -> None:
    """Check that a setting is a range to sample from.

    Args:
        where: Name of the setting.
        value: ``[low, high]``.

    Raises:
        ConfigError: It does not have two finite numbers, the lower one first.
    """
    if not (len(value) == 2 and value[0] <= value[1] and all(math.isfinite(bound) for bound in value)):
        raise ConfigError(f"{where}={value} must be a range [low, high] with low <= high")
