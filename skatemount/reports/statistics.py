"""Means over seeds with their intervals."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np


def t_quantile(freedom: int, probability: float) -> float:
    """Return the quantile of Student's t distribution, by summing its density and bisecting.

    Args:
        freedom: Degrees of freedom, at least 1.
        probability: Above 0.5 and below 1.
    """
    # With t = tan(a) the integral over the half line becomes one over [0, pi / 2) of sqrt(freedom) cos(a) ** (f - 1).
    steps = 20_000
    angles = (np.arange(steps) + 0.5) * (math.pi / 2 / steps)
    density = np.cos(angles) ** (freedom - 1)
    share = 0.5 + 0.5 * np.cumsum(density) / density.sum()
    return math.sqrt(freedom) * math.tan(float(np.interp(probability, share, angles + math.pi / 4 / steps)))


def mean_interval(values: Sequence[float], confidence: float = 0.95) -> tuple[float, float, float] | None:
    """Return mean and interval of the mean over seeds: ``mean +- t s / sqrt(n)``, with Student's t of n - 1.

    Student (W. S. Gosset), "The Probable Error of a Mean", Biometrika 6 (1908). The interval holds for values that
    scatter normally; for few seeds it is wide.

    Args:
        values: A value of each seed; those that are not finite are left out.
        confidence: Share of such intervals that contain the true mean.

    Returns:
        Mean, lower and upper end; the ends are nan for one value, and the result is None without any.
    """
    known = [value for value in values if math.isfinite(value)]
    if not known:
        return None
    mean = math.fsum(known) / len(known)
    if len(known) == 1:
        return mean, math.nan, math.nan
    spread = math.sqrt(math.fsum((value - mean) ** 2 for value in known) / (len(known) - 1))
    half = t_quantile(len(known) - 1, (1 + confidence) / 2) * spread / math.sqrt(len(known))
    return mean, mean - half, mean + half
