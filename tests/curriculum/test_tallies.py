"""Tallies of a curriculum that several ranks add up."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch import Tensor

from skatemount.curriculum.tallies import SharedTallies
from skatemount.utils.errors import ConfigError
from skatemount.utils.ranks import ALONE, Ranks


class Three(Ranks):
    """Three ranks that all have the same numbers."""

    size = 3

    def sum(self, *tensors: Tensor) -> None:
        for each in tensors:
            each *= 3


def curriculum(tally: Tensor) -> Any:
    return SimpleNamespace(tallies=lambda: [tally])


@pytest.mark.parametrize("ranks, expected", [(ALONE, [12.0, 5.0]), (Three(), [16.0, 5.0])])
def test_only_what_was_added_is_summed(ranks: Ranks, expected: list[float]) -> None:
    tally = torch.tensor([10.0, 5.0])
    shared = SharedTallies(curriculum(tally), ranks, "auto")
    shared.mark()
    tally[0] += 2
    shared.share()
    assert tally.tolist() == expected
    shared.mark()
    shared.share()
    assert tally.tolist() == expected


def test_a_curriculum_without_tallies_is_for_one_process() -> None:
    SharedTallies(None, Three(), "none").share()
    SharedTallies(SimpleNamespace(), ALONE, "mine").share()  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="^curriculum.kind=mine cannot be used by 3 ranks: .*method tallies"):
        SharedTallies(SimpleNamespace(), Three(), "mine")  # type: ignore[arg-type]
