"""Reducers, against numbers worked out by hand."""

from __future__ import annotations

import pytest
import torch

from skatemount.envs.tasks.reducers import REDUCERS


def shown(value: float) -> str:
    return f"{value:.1f} m"


def test_mean() -> None:
    mean = REDUCERS["mean"]
    found = mean.summarize(torch.tensor([1, 2, 6]))
    assert found == mean.number(found) == 3.0
    assert mean.text(found, shown) == "3.0 m"


def test_median_and_95_percent_quantile() -> None:
    median = REDUCERS["median"]
    found = median.summarize(torch.arange(101.0))
    assert found == {"median": 50.0, "p95": 95.0}
    assert median.number(found) == 50.0
    assert median.text(found, shown) == "median 50.0 m, 95 % within 95.0 m"


def test_share() -> None:
    share = REDUCERS["share"]
    found = share.summarize(torch.tensor([True, False, True, True]))
    assert found == share.number(found) == 0.75
    assert share.text(found, shown) == "75.0%"


@pytest.mark.parametrize("name", REDUCERS)
def test_without_values_there_is_no_number(name: str) -> None:
    reducer = REDUCERS[name]
    found = reducer.summarize(torch.zeros(0))
    assert reducer.number(found) is None
    assert reducer.text(found, shown) == "-"
