"""The standard deviation of the actions: its initial value, its bounds and its symmetry."""

from __future__ import annotations

import defaults
import pytest
import torch

from skatemount.models.distributions import BoundedNormalScale
from skatemount.models.symmetry import Reflection


@pytest.mark.parametrize(("low", "start", "high"), [(0.05, 0.5, 1.0), (0.2, 0.2, 0.2), (1e-3, 1.0, 10.0)])
def test_deviation_starts_where_asked(low: float, start: float, high: float) -> None:
    scale = BoundedNormalScale(12, defaults.network(min_std=low, init_std=start, max_std=high))
    _, std = scale(torch.zeros(7, 12))
    torch.testing.assert_close(std, torch.full((7, 12), start), rtol=1e-3, atol=0)


def test_the_upper_bound_only_falls_and_not_below_the_lower_one() -> None:
    scale = BoundedNormalScale(3, defaults.network(min_std=0.1, init_std=0.5, max_std=1.0))
    torch.nn.init.constant_(scale.parameter, 100.0)
    for high, due in ((2.0, 1.0), (0.4, 0.4), (0.7, 0.4), (0.01, 0.1)):
        scale.limit(high)
        torch.testing.assert_close(scale(torch.zeros(3))[1], torch.full((3,), due))


def test_mirrored_actions_have_the_same_deviation() -> None:
    scale = BoundedNormalScale(4, defaults.network(), Reflection(torch.tensor([1, 0, 3, 2]), torch.ones(4)))
    with torch.no_grad():
        scale.parameter.copy_(torch.tensor([-2.0, 1.0, 0.5, 3.0]))
        _, std = scale(torch.zeros(4))
    assert std[0] == std[1] and std[2] == std[3] and std[0] != std[2]
