"""Networks whose outputs are mirrored when their inputs are, so that what is learnt on one side holds on the other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional


class _SumAndDifference(torch.autograd.Function):
    """Torch would negate a gradient before it adds it: a pass more."""

    @staticmethod
    def forward(ctx: Any, one: Tensor, other: Tensor) -> tuple[Tensor, Tensor]:
        return one + other, one - other

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, Tensor]:
        return gradients[0] + gradients[1], gradients[0] - gradients[1]


def sum_and_difference(one: Tensor, other: Tensor) -> tuple[Tensor, Tensor]:
    """Both of two tensors of one shape."""
    both: tuple[Tensor, Tensor] = _SumAndDifference.apply(one, other)
    return both


class Mirror(nn.Module):
    """A left-right mirror image: ``image = x[..., permutation] * signs``. Twice, it changes nothing.

    Kept as buffers, so that a saved network can be rebuilt without the task that it was trained in.

    Args:
        permutation: ``[size]`` int64.
        signs: ``[size]``.

    Attributes:
        evens: Size of the even part.
    """

    permutation: Tensor
    signs: Tensor
    _one: Tensor
    _other: Tensor
    _sign: Tensor
    _share: Tensor

    def __init__(self, permutation: Tensor, signs: Tensor):
        super().__init__()
        # Clones: safetensors stores no tensor under two names.
        self.register_buffer("permutation", permutation.clone())
        self.register_buffer("signs", signs.clone())
        for name in ("_one", "_other", "_sign", "_share"):
            self.register_buffer(name, None, persistent=False)
        self._pair_up()
        self.register_load_state_dict_post_hook(lambda module, keys: module._pair_up())

    def _pair_up(self) -> None:
        """Which values make up the coordinates."""
        index = torch.arange(len(self.signs), device=self.signs.device)
        alone, pair = self.permutation == index, self.permutation > index
        even, odd = (((alone & (self.signs * sign > 0)) | pair).nonzero().flatten() for sign in (1, -1))
        self.evens = len(even)
        self._one = torch.cat((even, odd))
        self._other = self.permutation[self._one]
        self._sign = torch.cat((self.signs[even], -self.signs[odd])) * pair[self._one]
        self._share = torch.where(pair[self._one], 0.5, 1.0)
        self._halved = bool(
            pair.any() and (self.permutation == index.roll(len(index) // 2)).all() and (self.signs == 1).all()
        )

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

    def coordinates(self, values: Tensor) -> Tensor:
        """The even part of ``[..., size]`` values, ``evens`` numbers, and then the odd part, again ``[..., size]``.

        Sums and differences of a value and its image; what is its own image up to the sign is part of one of them.
        """
        one, other = (values.index_select(-1, index) for index in (self._one, self._other))
        return torch.addcmul(one, other, self._sign)

    def project(self, values: Tensor, odd: bool = False) -> Tensor:
        """What the even part of a vector is to be multiplied with, as `coordinates` gives it.

        Args:
            values: ``[..., size]``, what the vector itself is multiplied with.
            odd: The odd part, instead.
        """
        if self._halved:
            one, other = values.chunk(2, -1)
            return torch.sub(one, other).div_(2) if odd else torch.add(one, other).div_(2)
        which = slice(self.evens, None) if odd else slice(self.evens)
        one, other = (values.index_select(-1, index[which]) for index in (self._one, self._other))
        return torch.addcmul(one, other, self._sign[which]).mul_(self._share[which])

    def even(self, values: Tensor) -> Tensor:
        """The part of ``[..., size]`` values that is its own image."""
        return (values + self(values)) / 2


class EquivariantLinear(nn.Linear):
    """A linear layer for which the image of the input gives the image of the output.

    Its weight is the mean of a free one and that one's image (Ravanbakhsh, Schneider and Poczos, "Equivariance
    Through Parameter-Sharing", 2017).

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

    def apart(self, even: Tensor, odd: Tensor) -> tuple[Tensor, Tensor]:
        """What the even part of an input, and what its odd part gives: half of `forward`'s products.

        For hidden units, of which the second half are the images of the first.

        Args:
            even: Of ``before.coordinates``.
            odd: Likewise.

        Returns:
            The outputs' first half is the sum of the two, the second half the first less the second.
        """
        one, other = self.weight.chunk(2)
        to_even = self.before.project((one + other).div_(2))
        to_odd = self.before.project((one - other).div_(2), odd=True)
        return functional.linear(even, to_even, self.bias.view(2, -1).mean(0)), functional.linear(odd, to_odd)


class EquivariantMLP(nn.Sequential):
    """A network for which the image of the input gives the image of the output.

    The image of even parts is even, that of odd ones odd, so a symmetric layer mixes them nowhere; only activations do.

    Args:
        before: Mirror image of the inputs.
        after: Of the outputs.
        cells: Hidden units, an even number in each layer; the second half are the images of the first.
        activation: Of the hidden units.
    """

    def __init__(self, before: Mirror, after: Mirror, cells: Sequence[int], activation: type[nn.Module]):
        images = [before, *map(Mirror.halves, cells), after]
        layers: list[nn.Module] = []
        for first, second in pairwise(images):
            layers += [EquivariantLinear(first.copy(), second.copy()), activation()]
        super().__init__(*layers[:-1])

    def forward(self, input: Tensor) -> Tensor:
        """``[..., inputs]`` to ``[..., outputs]``."""
        return self.forward_even_odd(self.coordinates(input))

    def coordinates(self, input: Tensor) -> Tensor:
        """What the layers see of the input: the same each time, however they have changed."""
        return self._layers()[0].before.coordinates(input)

    def forward_even_odd(self, input: Tensor) -> Tensor:
        """What `forward` returns, from what `coordinates` does."""
        layers = self._layers()
        activations = [module for module in self if not isinstance(module, EquivariantLinear)]
        evens = layers[0].before.evens
        even, odd = input[..., :evens], input[..., evens:]
        for layer, activation in zip(layers, activations):
            units, images = map(activation, sum_and_difference(*layer.apart(even, odd)))
            even, odd = sum_and_difference(units, images)
        # A few outputs are not worth taking apart.
        last: Tensor = layers[-1](torch.cat((units, images), -1))
        return last

    def _layers(self) -> list[EquivariantLinear]:
        return [module for module in self if isinstance(module, EquivariantLinear)]
