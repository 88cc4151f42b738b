"""Standard deviations of the actions."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from skatemount.models.config import NetworkConfig
from skatemount.models.symmetry import Mirror


class BoundedNormalScale(nn.Module):
    """A learned standard deviation for each action, independent of the state and positive by construction.

    std = low + (high - low) sigmoid(parameter). The upper bound is a buffer, so that it is saved with the network.

    Args:
        size: Actions.
        config: Bounds and start.
        mirror: Mirror image of the actions, if both are to have the same deviation.
    """

    high: Tensor

    def __init__(self, size: int, config: NetworkConfig, mirror: Mirror | None = None):
        super().__init__()
        self._mirror = mirror
        self._low, span = config.min_std, config.max_std - config.min_std
        share = (config.init_std - self._low) / span if span else 0.5
        share = min(max(share, 1e-3), 1 - 1e-3)
        self.parameter = nn.Parameter(torch.full((size,), math.log(share / (1 - share))))
        self.register_buffer("high", torch.tensor(config.max_std))

    def limit(self, high: float) -> None:
        """Lower the upper bound, and with it every deviation; a bound that is lower already stays."""
        self.high.clamp_(max=max(high, self._low))

    def forward(self, loc: Tensor) -> tuple[Tensor, Tensor]:
        """``[..., size]`` means to means and standard deviations."""
        parameter: Tensor = self.parameter
        if self._mirror is not None:
            parameter = (parameter + parameter[self._mirror.permutation]) / 2
        std = self._low + (self.high - self._low) * torch.sigmoid(parameter)
        return loc, std.expand_as(loc)
