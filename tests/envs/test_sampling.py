"""Random numbers: their ranges, and that a generator repeats them."""

from __future__ import annotations

import pytest
import torch

from skatemount.envs.sampling import coarse_noise


@pytest.mark.parametrize("shape", [(1000, 7), (3, 1), (1, 13), (0, 4)])
def test_coarse_noise_is_uniform_between_minus_one_and_one(shape: tuple[int, int]) -> None:
    values = coarse_noise(shape, torch.Generator().manual_seed(0))
    assert values.shape == shape and values.dtype == torch.float32
    assert torch.equal(values, coarse_noise(shape, torch.Generator().manual_seed(0)))
    if shape[0] < 1000:
        return
    assert -1 <= values.min() < -0.99 and 0.99 < values.max() < 1
    # Mean and variance of a uniform distribution; neighbors come from one draw, and are independent all the same.
    assert abs(float(values.mean())) < 0.03 and float(values.var()) == pytest.approx(1 / 3, abs=0.02)
    columns = torch.corrcoef(values.T) - torch.eye(7)
    assert float(columns.abs().max()) < 0.15
    assert len(values.unique()) > 6000
