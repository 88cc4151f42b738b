"""Random numbers on the device of their generator."""

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
    """Draw uniform random numbers.

    Args:
        shape: Shape of the result.
        generator: Source of randomness; the result is on its device.
        bounds: Lower and upper bound.
        dtype: Type of the result.
    """
    low, high = bounds
    fraction = torch.rand(tuple(shape), generator=generator, device=generator.device, dtype=dtype)
    return fraction.mul_(high - low).add_(low)


def coarse_noise(shape: Sequence[int], generator: torch.Generator) -> Tensor:
    """Draw uniform random numbers in [-1, 1) with steps of 2^-15, faster on a CPU than `uniform`.

    Args:
        shape: Shape of the result.
        generator: Source of randomness; the result is on its device.

    Returns:
        A float32 tensor.
    """
    count = math.prod(shape)
    # Each 64-bit word of the generator gives four numbers.
    words = torch.empty((count + 3) // 4, dtype=torch.int64, device=generator.device)
    words.random_(-(2**63), None, generator=generator)
    return words.view(torch.int16)[:count].view(*shape).to(torch.float32).mul_(2**-15)


def either_sign(n: int, generator: torch.Generator) -> Tensor:
    """Draw ``[n]`` signs, 1 or -1 with equal probability."""
    return torch.where(uniform((n,), generator) < 0.5, -1.0, 1.0)
