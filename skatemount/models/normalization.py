"""Normalization of observations by their running statistics."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from skatemount.models.symmetry import Reflection


class RunningNormalizer(nn.Module):
    """Normalises by running mean and deviation, kept as buffers so that they are saved and exported with the network.

    Chan, Golub and LeVeque's update for batches (1983).

    Args:
        size: Values.
        clip: Bound on the normalised values.

    Attributes:
        mean: ``[size]``.
        var: ``[size]``.
        count: How many of each value it has seen.
        behind: ``[size]``, how many fewer it has seen of a value that came later, with `inherit`. It matters in
            training only, and is not saved with the network.
    """

    mean: Tensor
    var: Tensor
    count: Tensor
    behind: Tensor

    def __init__(self, size: int, clip: float = 10.0):
        super().__init__()
        self._clip = clip
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("var", torch.ones(size))
        self.register_buffer("count", torch.zeros((), dtype=torch.float64))
        self.register_buffer("behind", torch.zeros(size, dtype=torch.float64), persistent=False)

    @torch.no_grad()
    def observe(self, values: Tensor, mirror: Reflection | None = None) -> None:
        """Take values into account.

        Args:
            values: ``[..., size]``.
            mirror: Their mirror images are taken into account, too, if it is given.
        """
        flat = values.flatten(0, -2)
        n = flat.shape[0]
        # Two passes over whole rows; torch's var_mean would go down the columns.
        mean = flat.mean(0)
        var = (flat - mean).square_().mean(0)
        if mirror is not None:
            # The images have the image of the mean, and the variances in another order: no need to make them.
            n, image = 2 * n, mirror(mean)
            var = (var + var[mirror.permutation]) / 2 + ((mean - image) / 2).square()
            mean = (mean + image) / 2
        self.count.add_(n)
        share = (n / (self.count - self.behind)).to(mean.dtype)
        shift = mean - self.mean
        self.var.copy_(self.var * (1 - share) + var * share + shift.square() * share * (1 - share))
        self.mean.add_(shift * share)

    @torch.no_grad()
    def inherit(self, other: RunningNormalizer, places: Tensor) -> None:
        """Continue another one's statistics, as those of the values at the given places, ``[other's size]``.

        All other values begin with what is observed next: the other one's count would hold them where they are.
        """
        self.mean[places], self.var[places] = other.mean, other.var
        self.count.copy_(other.count)
        self.behind.copy_(other.count.expand_as(self.behind))
        self.behind[places] = other.behind

    def reset_statistics(self) -> None:
        """Let what is observed next replace what was observed so far, instead of adding to it."""
        self.count.zero_()
        self.behind.zero_()

    def forward(self, values: Tensor) -> Tensor:
        """``[..., size]`` to the same, with mean 0 and deviation 1, clipped."""
        return ((values - self.mean) * torch.rsqrt(self.var + 1e-4)).clamp(-self._clip, self._clip)
