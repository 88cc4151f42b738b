"""Counts and durations as short text."""

from __future__ import annotations

import math

import pytest

from skatemount.utils.formatting import format_changes, format_count, format_duration


@pytest.mark.parametrize(
    ("value", "text"),
    [(0, "0"), (950, "950"), (15_234, "15.2k"), (1_200_000, "1.20M"), (3e9, "3.00G"), (-2500, "-2.5k")],
)
def test_counts(value: float, text: str) -> None:
    assert format_count(value) == text


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ([], ""),
        (["board=mini"], ", changed by board=mini"),
        (["board=mini", "start.x=[0,1]"], ", changed by board=mini, start.x=[0,1]"),
        (["a=1" * 30, "b=2"], f", changed by {'a=1' * 30} and 1 more setting"),
        (["board=mini", "b=2" * 30, "c=3"], ", changed by board=mini and 2 more settings"),
    ],
)
def test_changes(settings: list[str], text: str) -> None:
    assert format_changes(settings) == text


@pytest.mark.parametrize(
    ("seconds", "text"), [(0, "0:00"), (59.9, "0:59"), (61, "1:01"), (3600, "1:00:00"), (7325, "2:02:05")]
)
def test_durations(seconds: float, text: str) -> None:
    assert format_duration(seconds) == text


@pytest.mark.parametrize("seconds", [math.inf, math.nan])
def test_an_unknown_duration_is_a_dash(seconds: float) -> None:
    assert format_duration(seconds) == "-"
