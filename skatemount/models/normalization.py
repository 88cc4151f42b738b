"""Normalization of observations by their running statistics."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from skatemount.models.symmetry import Reflection
from skatemount.utils.ranks import ALONE, Ranks


class RunningNormalizer(nn.Module):
    """Normalization by running mean and deviation, kept as buffers so that they are saved with the network.

    The update for batches is that of Chan, Golub and LeVeque, "Algorithms for computing the sample variance" (1983).

    Args:
        size: Number of features.
        clip: Bound on the normalized values.

    Attributes:
        mean: ``[size]`` float32.
        var: ``[size]`` float32.
        count: ``[size]`` float64, samples seen of each feature. Features that were added to a policy have seen fewer.
        ranks: The processes whose batches count as one.
    """

    ranks: Ranks = ALONE

    mean: Tensor
    var: Tensor
    count: Tensor

    def __init__(self, size: int, clip: float = 10.0):
        super().__init__()
        self._clip = clip
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("var", torch.ones(size))
        self.register_buffer("count", torch.zeros(size, dtype=torch.float64))

    @torch.no_grad()
    def observe(self, values: Tensor, mirror: Reflection | None = None) -> None:
        """Update the statistics with a batch.

        Args:
            values: ``[..., size]``.
            mirror: If given, the batch's mirror image counts as well.
        """
        flat = values.flatten(0, -2)
        n = flat.shape[0]
        # Two passes over whole rows; torch's var_mean would go down the columns.
        mean = flat.mean(0)
        var = (flat - mean).square_().mean(0)
        if mirror is not None:
            # The images have the image of the mean, and the same variances in another order: no need to compute them.
            n, image = 2 * n, mirror(mean)
            var = (var + var[mirror.permutation]) / 2 + ((mean - image) / 2).square()
            mean = (mean + image) / 2
        if self.ranks.size > 1:
            n, mean, var = self._of_all_ranks(n, mean, var)
        self.count.add_(n)
        share = (n / self.count).to(mean.dtype)
        shift = mean - self.mean
        self.var.copy_(self.var * (1 - share) + var * share + shift.square() * share * (1 - share))
        self.mean.add_(shift * share)

    def _of_all_ranks(self, n: int, mean: Tensor, var: Tensor) -> tuple[int, Tensor, Tensor]:
        """Return number, mean and variance of the batches of all ranks, which are of the same size."""
        own = mean.clone()
        self.ranks.mean(mean)
        spread = var + (own - mean).square()
        self.ranks.mean(spread)
        return n * self.ranks.size, mean, spread

    @torch.no_grad()
    def inherit(self, other: RunningNormalizer, places: Tensor) -> None:
        """Continue the statistics of another normalizer.

        Args:
            other: The other normalizer.
            places: ``[other's size]`` int64, where its features are among these. All other features start from zero
                samples, so that the first batch sets their mean and deviation.
        """
        self.count.zero_()
        self.mean[places], self.var[places], self.count[places] = other.mean, other.var, other.count

    def reset_statistics(self) -> None:
        """Forget all samples, so that the next batch replaces the statistics."""
        self.count.zero_()

    def forward(self, values: Tensor) -> Tensor:
        """Return ``[..., size]`` values normalized to mean 0 and deviation 1, and clipped."""
        return ((values - self.mean) * torch.rsqrt(self.var + 1e-4)).clamp(-self._clip, self._clip)

    def _load_from_state_dict(self, state_dict: dict[str, Any], prefix: str, *args: Any) -> None:
        key = f"{prefix}count"
        if key in state_dict and is_old_count(key, state_dict[key]):
            state_dict[key] = state_dict[key].expand_as(self.count)
        super()._load_from_state_dict(state_dict, prefix, *args)


def is_old_count(key: str, saved: Tensor) -> bool:
    """Return whether a saved tensor is one count for all features, which is what older versions saved."""
    return key.rpartition(".")[2] == "count" and saved.ndim == 0
