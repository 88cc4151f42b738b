"""Networks whose outputs are mirrored when their inputs are, so that what is learnt on one side holds on the other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional


class Mirror(nn.Module):
    """A left-right mirror image: ``image = x[..., permutation] * signs``. Twice, it changes nothing.

    Kept as buffers, so that a saved network can be rebuilt without the task that it was trained in.

    Args:
        permutation: ``[size]`` int64.
        signs: ``[size]``.
    """

    permutation: Tensor
    signs: Tensor

    def __init__(self, permutation: Tensor, signs: Tensor):
        super().__init__()
        # Clones: safetensors stores no tensor under two names.
        self.register_buffer("permutation", permutation.clone())
        self.register_buffer("signs", signs.clone())

    @classmethod
    def halves(cls, size: int) -> Mirror:
        """Of hidden units: the second half are the images of the first."""
        return cls(torch.arange(size).roll(size // 2), torch.ones(size))

    @classmethod
    def same(cls, size: int) -> Mirror:
        """Of what is its own image."""
        return cls(torch.arange(size), torch.ones(size))

    @classmethod
    def joined(cls, first: Mirror, second: Mirror) -> Mirror:
        """Of two blocks of values, one after the other."""
        permutation = torch.cat((first.permutation, second.permutation + len(first.signs)))
        return cls(permutation, torch.cat((first.signs, second.signs)))

    def copy(self) -> Mirror:
        """Another one alike."""
        return Mirror(self.permutation, self.signs)

    def forward(self, values: Tensor) -> Tensor:
        """The image of ``[..., size]`` values."""
        return values.index_select(-1, self.permutation) * self.signs

    def even(self, values: Tensor) -> Tensor:
        """The part of ``[..., size]`` values that is its own image."""
        return (values + self(values)) / 2


class SymmetricLinear(nn.Linear):
    """A linear layer for which the image of the input gives the image of the output.

    Its weight is the mean of a free one and that one's image (Ravanbakhsh, Schneider and Poczos, "Equivariance
    Through Parameter-Sharing", 2017), so that it costs a plain layer's products.

    Args:
        before: Mirror image of the inputs.
        after: Of the outputs.
    """

    def __init__(self, before: Mirror, after: Mirror):
        super().__init__(len(before.signs), len(after.signs))
        self.before, self.after = before, after
        with torch.no_grad():
            # The mean of two independent weights is smaller than one by this.
            self.weight.mul_(math.sqrt(2))

    def forward(self, input: Tensor) -> Tensor:
        """``[..., inputs]`` to ``[..., outputs]``."""
        image = self.after(self.before(self.weight).T).T
        return functional.linear(input, (self.weight + image) / 2, self.after.even(self.bias))


def symmetric_mlp(before: Mirror, after: Mirror, cells: Sequence[int], activation: type[nn.Module]) -> nn.Sequential:
    """A network for which the image of the input gives the image of the output.

    Args:
        before: Mirror image of the inputs.
        after: Of the outputs.
        cells: Hidden units, an even number in each layer.
        activation: Of the hidden units.
    """
    images = [before, *map(Mirror.halves, cells), after]
    layers: list[nn.Module] = []
    for first, second in pairwise(images):
        layers += [SymmetricLinear(first.copy(), second.copy()), activation()]
    return nn.Sequential(*layers[:-1])
