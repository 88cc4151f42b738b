"""Counts and durations as text."""

from __future__ import annotations

import math
from collections.abc import Sequence


def format_count(value: float) -> str:
    """Return a count in short form, such as 950, 15.2k, 1.20M or 3.00G."""
    for size, letter, digits in ((1e9, "G", 2), (1e6, "M", 2), (1e3, "k", 1)):
        if abs(value) >= size:
            return f"{value / size:.{digits}f}{letter}"
    return f"{value:.0f}"


def format_changes(settings: Sequence[str], room: int = 60) -> str:
    """Return ", changed by ..." for a title; "" without settings.

    Args:
        settings: Settings as on the command line.
        room: Letters that they may take; at least the first one is named, and those without room are counted.
    """
    if not settings:
        return ""
    named = [settings[0]]
    for each in settings[1:]:
        if len(", ".join([*named, each])) > room:
            break
        named.append(each)
    left = len(settings) - len(named)
    return f", changed by {', '.join(named)}" + (f" and {left} more setting{'s' * (left > 1)}" if left else "")


def format_duration(seconds: float) -> str:
    """Return a time in seconds as m:ss or h:mm:ss, or ``-`` if it is not finite."""
    if not math.isfinite(seconds):
        return "-"
    minutes, s = divmod(int(seconds), 60)
    hours, m = divmod(minutes, 60)
    return f"{hours}:{m:02}:{s:02}" if hours else f"{m}:{s:02}"
