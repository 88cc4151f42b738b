"""Statistics of success counts."""

from __future__ import annotations

import math
from statistics import NormalDist


def wilson_interval(successes: int, trials: int, confidence: float = 0.95) -> tuple[float, float]:
    """Wilson's score interval of a success rate.

    With rate p = successes / n and z the normal quantile of (1 + confidence) / 2::

        (p + z^2 / 2n +- z sqrt(p (1 - p) / n + z^2 / 4n^2)) / (1 + z^2 / n)

    E. B. Wilson, "Probable Inference, the Law of Succession, and Statistical Inference", Journal of
    the American Statistical Association 22 (1927). Unlike the textbook's interval it stays within 0
    and 1 and is sound for rates near both.

    Args:
        successes: How many trials succeeded.
        trials: How many there were.
        confidence: Share of such intervals that hold the true rate, between 0 and 1.

    Returns:
        Lower and upper end.

    Raises:
        ValueError: No trials, more successes than trials, or no such confidence.
    """
    if trials < 1:
        raise ValueError(f"trials={trials} must be at least 1")
    if not 0 <= successes <= trials:
        raise ValueError(f"successes={successes} must be within 0 and trials={trials}")
    if not 0 < confidence < 1:
        raise ValueError(f"confidence={confidence} must be between 0 and 1")
    z = NormalDist().inv_cdf((1 + confidence) / 2)
    n, p = trials, successes / trials
    centre = p + z * z / (2 * n)
    half = z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    scale = 1 + z * z / n
    # At the ends the formula gives 0 and 1 exactly, arithmetic almost.
    low = 0.0 if successes == 0 else (centre - half) / scale
    high = 1.0 if successes == n else (centre + half) / scale
    return low, high
