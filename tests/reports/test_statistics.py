"""Means over seeds."""

from __future__ import annotations

import math

import pytest

from skatemount.reports.statistics import mean_interval, t_quantile


@pytest.mark.parametrize(
    ("freedom", "quantile"), [(1, 12.706), (2, 4.303), (3, 3.182), (4, 2.776), (9, 2.262), (29, 2.045), (200, 1.972)]
)
def test_quantiles_are_those_of_the_tables(freedom: int, quantile: float) -> None:
    assert t_quantile(freedom, 0.975) == pytest.approx(quantile, abs=6e-4)


def test_the_interval_of_a_mean() -> None:
    mean, low, high = mean_interval([1.0, 2.0, 3.0])
    assert mean == 2.0 and high - mean == pytest.approx(4.303 / math.sqrt(3), abs=1e-3)
    assert low + high == pytest.approx(4.0)
    assert mean_interval([]) is None and mean_interval([math.nan]) is None
    mean, low, high = mean_interval([0.5, math.nan])
    assert mean == 0.5 and math.isnan(low) and math.isnan(high)
