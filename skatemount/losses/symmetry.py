"""Left-right symmetry: the mirror image of a step is as good a step."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor

from skatemount.envs.mdp import Mdp
from skatemount.envs.mirror import mirror_map


class Symmetry:
    """Mirror images of observations and actions.

    Args:
        maps: Permutation and signs by key: ``mirrored = x[..., permutation] * signs``.
    """

    def __init__(self, maps: dict[str, tuple[Tensor, Tensor]]):
        self._maps = maps

    @classmethod
    def of(cls, mdp: Mdp) -> Symmetry:
        """The mirror images of a task.

        Raises:
            ConfigError: An observation term has none.
        """
        return cls(
            {
                "observation": mdp.observation.mirror(),
                "privileged": mdp.privileged.mirror(),
                "action": mirror_map("joints", 12),
            }
        )

    def mirror(self, key: str, values: Tensor) -> Tensor:
        """The mirror image of ``[..., D]`` values of a key."""
        permutation, signs = self._maps[key]
        return values[..., permutation] * signs

    def augment(self, batch: TensorDictBase) -> TensorDictBase:
        """A batch with the mirror image of every row after it; what has no mirror image is repeated.

        Args:
            batch: ``[B]``.

        Returns:
            ``[2 B]``.
        """
        mirrored = batch.clone(False)
        for key in self._maps:
            mirrored[key] = self.mirror(key, batch[key])
        return torch.cat((batch, mirrored))

    def flip(self, batch: TensorDictBase) -> TensorDictBase:
        """A batch with every other row replaced by its mirror image; rows are expected in random order.

        Args:
            batch: ``[B]``.

        Returns:
            ``[B]``.
        """
        mirrored = batch.clone(False)
        for key in self._maps:
            values = batch[key].clone()
            values[::2] = self.mirror(key, values[::2])
            mirrored[key] = values
        return mirrored
