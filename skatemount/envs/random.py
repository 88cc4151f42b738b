"""Random numbers on whichever device their generator is."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor


def uniform(
    shape: Sequence[int],
    generator: torch.Generator,
    bounds: Sequence[float] = (0.0, 1.0),
    dtype: torch.dtype = torch.float32,
) -> Tensor:
    """Uniform random numbers.

    Args:
        shape: Of the result.
        generator: Source of randomness; the result is on its device.
        bounds: Low and high.
        dtype: Of the result.
    """
    low, high = bounds
    share = torch.rand(tuple(shape), generator=generator, device=generator.device, dtype=dtype)
    return share.mul_(high - low).add_(low)


def either_sign(n: int, generator: torch.Generator) -> Tensor:
    """``[n]`` of 1 and -1, as often one as the other."""
    return torch.where(uniform((n,), generator) < 0.5, -1.0, 1.0)
