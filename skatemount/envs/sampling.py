"""Random numbers on whichever device their generator is."""

from __future__ import annotations

import math
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


def coarse_noise(shape: Sequence[int], generator: torch.Generator) -> Tensor:
    """Uniform random numbers from -1 on and below 1, in steps of 2^-15, for less time on a CPU than those of `uniform`.

    Args:
        shape: Of the result.
        generator: Source of randomness; the result is on its device.
    """
    count = math.prod(shape)
    # Four numbers from one of the generator's 64 bits.
    words = torch.empty((count + 3) // 4, dtype=torch.int64, device=generator.device)
    words.random_(-(2**63), None, generator=generator)
    return words.view(torch.int16)[:count].view(*shape).to(torch.float32).mul_(2**-15)


def either_sign(n: int, generator: torch.Generator) -> Tensor:
    """``[n]`` of 1 and -1, as often one as the other."""
    return torch.where(uniform((n,), generator) < 0.5, -1.0, 1.0)
