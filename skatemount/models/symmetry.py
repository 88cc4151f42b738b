"""Left-right symmetric networks: the reflected input gives the reflected output, so both sides are learned at once."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional


class Reflection(nn.Module):
    """The left-right mirror image of a vector: ``image = x[..., permutation] * signs``, its own inverse.

    The even part of a vector is its own image; the odd part is the negative of its own image. Together they have as
    many entries as the vector. Permutation and signs are buffers, so a saved network needs no task to be rebuilt.

    Args:
        permutation: ``[size]`` int64.
        signs: ``[size]``, each 1 or -1.

    Attributes:
        even_size: Number of entries of the even part.
    """

    permutation: Tensor
    signs: Tensor
    _index: Tensor
    _partner: Tensor
    _sign: Tensor
    _fold: Tensor

    def __init__(self, permutation: Tensor, signs: Tensor):
        super().__init__()
        # Clones, because safetensors does not store one tensor under two names.
        self.register_buffer("permutation", permutation.clone())
        self.register_buffer("signs", signs.clone())
        for name in ("_index", "_partner", "_sign", "_fold"):
            self.register_buffer(name, None, persistent=False)
        self._find_pairs()
        self.register_load_state_dict_post_hook(lambda module, keys: module._find_pairs())

    def _find_pairs(self) -> None:
        """Work out which entries are added or subtracted to get the even and the odd part."""
        index = torch.arange(len(self.signs), device=self.signs.device)
        alone, pair = self.permutation == index, self.permutation > index
        even, odd = (((alone & (self.signs * sign > 0)) | pair).nonzero().flatten() for sign in (1, -1))
        self.even_size = len(even)
        self._index = torch.cat((even, odd))
        self._partner = self.permutation[self._index]
        self._sign = torch.cat((self.signs[even], -self.signs[odd])) * pair[self._index]
        self._fold = torch.where(pair[self._index], 0.5, 1.0)
        self._swaps_halves = bool(
            pair.any() and (self.permutation == index.roll(len(index) // 2)).all() and (self.signs == 1).all()
        )

    @classmethod
    def paired(cls, size: int) -> Reflection:
        """Return the reflection of hidden units: the second half are the images of the first half."""
        return cls(torch.arange(size).roll(size // 2), torch.ones(size))

    @classmethod
    def identity(cls, size: int) -> Reflection:
        """Return the reflection of a vector that is its own image."""
        return cls(torch.arange(size), torch.ones(size))

    @classmethod
    def concat(cls, first: Reflection, second: Reflection) -> Reflection:
        """Return the reflection of two concatenated vectors."""
        permutation = torch.cat((first.permutation, second.permutation + len(first.signs)))
        return cls(permutation, torch.cat((first.signs, second.signs)))

    def copy(self) -> Reflection:
        """Return a copy with buffers of its own."""
        return Reflection(self.permutation, self.signs)

    def forward(self, values: Tensor) -> Tensor:
        """Return the image of ``[..., size]`` values."""
        return values.index_select(-1, self.permutation) * self.signs

    def to_even_odd(self, values: Tensor) -> Tensor:
        """Split ``[..., size]`` values into the even part, `even_size` entries, followed by the odd part.

        The entries are sums and differences of a value and its image. A value that is its own image, up to the sign,
        is copied into the part that it belongs to.

        Returns:
            ``[..., size]``.
        """
        one, other = (values.index_select(-1, index) for index in (self._index, self._partner))
        return torch.addcmul(one, other, self._sign)

    def fold_weight(self, weight: Tensor, odd: bool = False) -> Tensor:
        """Return the weight that gives with one part, as `to_even_odd` gives it, what ``weight`` gives with its vector.

        Args:
            weight: ``[..., size]``, the weight of the whole vector.
            odd: Take the odd part, not the even one.

        Returns:
            ``[..., even_size]``, or ``[..., size - even_size]`` for the odd part.
        """
        if self._swaps_halves:
            one, other = weight.chunk(2, -1)
            return torch.sub(one, other).div_(2) if odd else torch.add(one, other).div_(2)
        part = slice(self.even_size, None) if odd else slice(self.even_size)
        one, other = (weight.index_select(-1, index[part]) for index in (self._index, self._partner))
        return torch.addcmul(one, other, self._sign[part]).mul_(self._fold[part])

    def even_part(self, values: Tensor) -> Tensor:
        """Return the mean of ``[..., size]`` values and their image, which is its own image."""
        return (values + self(values)) / 2


class EquivariantLinear(nn.Linear):
    """A linear layer for which the reflected input gives the reflected output.

    Its weight is the mean of a free weight and that weight's image (Ravanbakhsh, Schneider and Poczos, "Equivariance
    Through Parameter-Sharing", 2017).

    Args:
        before: Reflection of the inputs.
        after: Reflection of the outputs.
    """

    def __init__(self, before: Reflection, after: Reflection):
        super().__init__(len(before.signs), len(after.signs))
        self.before, self.after = before, after
        with torch.no_grad():
            # The mean of two independent weights has a deviation smaller by this factor than one of them.
            self.weight.mul_(math.sqrt(2))

    def forward(self, input: Tensor) -> Tensor:
        """Map ``[..., inputs]`` to ``[..., outputs]``."""
        image = self.after(self.before(self.weight).T).T
        return functional.linear(input, (self.weight + image) / 2, self.after.even_part(self.bias))

    def forward_even_odd(self, even: Tensor, odd: Tensor) -> tuple[Tensor, Tensor]:
        """Apply the layer to the even and the odd part separately, with half of `forward`'s multiplications.

        Works only if ``after`` is `Reflection.paired`.

        Args:
            even: ``[..., even_size]``, the even part as `Reflection.to_even_odd` of ``before`` gives it.
            odd: ``[..., inputs - even_size]``, the odd part.

        Returns:
            The even and the odd part of the outputs, ``[..., outputs / 2]`` each. The first half of the outputs is
            their sum, the second half is their difference.
        """
        one, other = self.weight.chunk(2)
        to_even = self.before.fold_weight((one + other).div_(2))
        to_odd = self.before.fold_weight((one - other).div_(2), odd=True)
        return functional.linear(even, to_even, self.bias.view(2, -1).mean(0)), functional.linear(odd, to_odd)


class EquivariantMLP(nn.Sequential):
    """A multilayer perceptron for which the reflected input gives the reflected output.

    A symmetric linear layer maps even parts to even parts and odd parts to odd parts. Only the activations mix them.

    Args:
        before: Reflection of the inputs.
        after: Reflection of the outputs.
        cells: Hidden units, an even number in each layer; the second half are the images of the first half.
        activation: Activation of the hidden units.
    """

    def __init__(self, before: Reflection, after: Reflection, cells: Sequence[int], activation: type[nn.Module]):
        reflections = [before, *map(Reflection.paired, cells), after]
        layers: list[nn.Module] = []
        for first, second in pairwise(reflections):
            layers += [EquivariantLinear(first.copy(), second.copy()), activation()]
        super().__init__(*layers[:-1])

    def forward(self, input: Tensor) -> Tensor:
        """Map ``[..., inputs]`` to ``[..., outputs]``."""
        return self.forward_even_odd(self.to_even_odd(input))

    def to_even_odd(self, input: Tensor) -> Tensor:
        """Split ``[..., inputs]`` values into even and odd part; the result does not depend on the weights."""
        return self._layers()[0].before.to_even_odd(input)

    def forward_even_odd(self, parts: Tensor) -> Tensor:
        """Map ``[..., inputs]`` values, as `to_even_odd` returns them, to ``[..., outputs]``."""
        # benchmarks/learner_parts.py: with the layers' plain forward passes a PPO update takes 1.18 to 1.22 x the time.
        layers = self._layers()
        activations = [module for module in self if not isinstance(module, EquivariantLinear)]
        even_size = layers[0].before.even_size
        even, odd = parts[..., :even_size], parts[..., even_size:]
        for layer, activation in zip(layers, activations):
            even, odd = layer.forward_even_odd(even, odd)
            units, images = activation(even + odd), activation(even - odd)
            even, odd = units + images, units - images
        # The last layer has few outputs: splitting it would save nothing.
        outputs: Tensor = layers[-1](torch.cat((units, images), -1))
        return outputs

    def _layers(self) -> list[EquivariantLinear]:
        return [module for module in self if isinstance(module, EquivariantLinear)]
