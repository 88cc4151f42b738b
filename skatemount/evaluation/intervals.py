"""Confidence intervals of success rates."""

from __future__ import annotations

import math
from statistics import NormalDist


def wilson_interval(successes: int, trials: int, confidence: float = 0.95) -> tuple[float, float]:
    """Return Wilson's score interval of a success rate.

    With ``p = successes / n`` and ``z`` the normal quantile of ``(1 + confidence) / 2``::

        (p + z^2 / 2n +- z sqrt(p (1 - p) / n + z^2 / 4n^2)) / (1 + z^2 / n)

    E. B. Wilson, "Probable Inference, the Law of Succession, and Statistical Inference", Journal of the American
    Statistical Association 22 (1927). Unlike the textbook's interval it stays within 0 and 1, and it holds for rates
    near both.

    Args:
        successes: Number of successes.
        trials: Number of trials, n.
        confidence: Share of such intervals that contain the true rate, above 0 and below 1.

    Returns:
        Lower and upper end.

    Raises:
        ValueError: ``trials`` is below 1, ``successes`` is not within 0 and ``trials``, or ``confidence`` is not within
            0 and 1.
    """
    if trials < 1:
        raise ValueError(f"trials={trials} must be at least 1")
    if not 0 <= successes <= trials:
        raise ValueError(f"successes={successes} must be within 0 and trials={trials}")
    if not 0 < confidence < 1:
        raise ValueError(f"confidence={confidence} must be between 0 and 1")
    z = NormalDist().inv_cdf((1 + confidence) / 2)
    n, p = trials, successes / trials
    center = p + z * z / (2 * n)
    half = z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    scale = 1 + z * z / n
    # The formula gives exactly 0 and 1 here, floating-point arithmetic does not.
    low = 0.0 if successes == 0 else (center - half) / scale
    high = 1.0 if successes == n else (center + half) / scale
    return low, high
