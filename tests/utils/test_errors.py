"""Ranges in the settings."""

from __future__ import annotations

import math

import pytest

from skatemount.utils.errors import ConfigError, check_range


@pytest.mark.parametrize("value", [[0.0, 0.0], [-1, 2], (0.5, 1.5)])
def test_a_range_has_two_ordered_numbers(value: list[float]) -> None:
    check_range("start.x", value)


@pytest.mark.parametrize("value", [[1.0, 0.0], [1.0], [0.0, 1.0, 2.0], [0.0, math.inf], [math.nan, 1.0], []])
def test_anything_else_is_refused_in_one_line(value: list[float]) -> None:
    with pytest.raises(ConfigError) as error:
        check_range("start.x", value)
    assert str(error.value) == f"start.x={value} must be a range [low, high] with low <= high"
