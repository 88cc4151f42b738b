"""Counts and durations as text."""

from __future__ import annotations

import math


def format_count(value: float) -> str:
    """Return a count in short form, such as 950, 15.2k, 1.20M or 3.00G."""
    for size, letter, digits in ((1e9, "G", 2), (1e6, "M", 2), (1e3, "k", 1)):
        if abs(value) >= size:
            return f"{value / size:.{digits}f}{letter}"
    return f"{value:.0f}"


def format_duration(seconds: float) -> str:
    """Return a time in seconds as m:ss or h:mm:ss, or ``-`` if it is not finite."""
    if not math.isfinite(seconds):
        return "-"
    minutes, s = divmod(int(seconds), 60)
    hours, m = divmod(minutes, 60)
    return f"{hours}:{m:02}:{s:02}" if hours else f"{m}:{s:02}"
