"""Standard deviations of the actions."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from skatemount.models.config import NetworkConfig
from skatemount.models.symmetry import Reflection


class BoundedNormalScale(nn.Module):
    """A learned standard deviation for each action, independent of the state and within bounds by construction.

    ``std = low + (high - low) * sigmoid(parameter)``. The upper bound is a buffer, so it is saved with the network.

    Args:
        size: Number of actions.
        config: Bounds and initial value.
        reflection: Reflection of the actions, to give mirrored actions the same deviation; None for free deviations.
    """

    high: Tensor

    def __init__(self, size: int, config: NetworkConfig, reflection: Reflection | None = None):
        super().__init__()
        # Saved weights have this name.
        self._mirror = reflection
        self._low, span = config.min_std, config.max_std - config.min_std
        share = (config.init_std - self._low) / span if span else 0.5
        # The sigmoid reaches neither end.
        share = min(max(share, 1e-3), 1 - 1e-3)
        self.parameter = nn.Parameter(torch.full((size,), math.log(share / (1 - share))))
        self.register_buffer("high", torch.tensor(config.max_std))

    def limit(self, high: float) -> None:
        """Lower the upper bound, and with it every deviation; keep a bound that is lower already."""
        self.high.clamp_(max=max(high, self._low))

    def forward(self, loc: Tensor) -> tuple[Tensor, Tensor]:
        """Return ``[..., size]`` means unchanged, and standard deviations of the same shape."""
        parameter: Tensor = self.parameter
        if self._mirror is not None:
            parameter = (parameter + parameter[self._mirror.permutation]) / 2
        std = self._low + (self.high - self._low) * torch.sigmoid(parameter)
        return loc, std.expand_as(loc)
