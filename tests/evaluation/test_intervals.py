"""Wilson's interval of a success rate."""

from __future__ import annotations

import pytest

from skatemount.evaluation.intervals import wilson_interval


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    # Newcombe, "Two-sided confidence intervals for the single proportion", Statistics in Medicine
    # 17 (1998), table I, method 3.
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)],
)  # fmt: skip
def test_published_values(successes: int, trials: int, low: float, high: float) -> None:
    assert wilson_interval(successes, trials) == pytest.approx((low, high), abs=5e-5)


def test_mirrored_when_successes_and_failures_are_swapped() -> None:
    low, high = wilson_interval(29, 29 + 71, 0.9)
    assert wilson_interval(71, 100, 0.9) == pytest.approx((1 - high, 1 - low))


def test_all_successes_reach_one_and_stay_below_certainty() -> None:
    low, high = wilson_interval(20, 20)
    assert high == 1.0
    assert low == pytest.approx(1 - 0.1611, abs=5e-5)


def test_more_confidence_is_a_wider_interval() -> None:
    narrow, wide = wilson_interval(30, 100, 0.5), wilson_interval(30, 100, 0.99)
    assert wide[0] < narrow[0] < 0.3 < narrow[1] < wide[1]


@pytest.mark.parametrize(
    ("arguments", "named"),
    [((1, 0), "trials=0"), ((3, 2), "successes=3"), ((-1, 2), "successes=-1"), ((1, 2, 1.0), "confidence=1.0")],
)  # fmt: skip
def test_impossible_counts_are_refused(arguments: tuple, named: str) -> None:
    with pytest.raises(ValueError, match=named):
        wilson_interval(*arguments)
