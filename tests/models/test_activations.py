"""Activations equal torch's, in values and gradients."""

from __future__ import annotations

import pytest
import torch

from skatemount.models.activations import ELU


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_elu_is_torchs(dtype: torch.dtype) -> None:
    values = [-1e30, -100.0, -20.0, -1.0, -1e-3, -1e-6, -0.0, 0.0, 1e-6, 1e-3, 1.0, 100.0, 1e30]
    x = torch.tensor(values, dtype=dtype, requires_grad=True)
    expected = torch.nn.functional.elu(x)
    torch.testing.assert_close(ELU()(x), expected, rtol=0.0, atol=1e-7)
    (slope,) = torch.autograd.grad(ELU()(x).sum(), x)
    torch.testing.assert_close(slope, torch.autograd.grad(expected.sum(), x)[0], rtol=0.0, atol=1e-6)
    assert bool(ELU()(torch.tensor([torch.nan], dtype=dtype)).isnan())
