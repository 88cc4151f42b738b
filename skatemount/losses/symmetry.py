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

    def image(self, batch: TensorDictBase) -> TensorDictBase:
        """The mirror image of every row of a batch; what has no mirror image stays.

        An image was never acted out: if ``image_log_prob`` is there, the old policy's log-probability of the image's
        action in the image's state, it becomes ``action_log_prob``. With the original's instead, the ratio would start
        far from 1 wherever the policy is a little asymmetric, and much of the images' gradient would be clipped away.

        Args:
            batch: ``[B]``.
        """
        mirrored = batch.clone(False)
        for key in self._maps:
            mirrored[key] = self.mirror(key, batch[key])
        if "image_log_prob" in batch.keys():
            mirrored["action_log_prob"] = batch["image_log_prob"]
        return mirrored

    def augment(self, batch: TensorDictBase) -> TensorDictBase:
        """A batch with the mirror image of every row after it.

        Args:
            batch: ``[B]``.

        Returns:
            ``[2 B]``.
        """
        return torch.cat((batch, self.image(batch)))

    def flip(self, batch: TensorDictBase) -> TensorDictBase:
        """A batch with every other row replaced by its mirror image; rows are expected in random order.

        Args:
            batch: ``[B]``.

        Returns:
            ``[B]``, in another order.
        """
        return torch.cat((self.image(batch[::2]), batch[1::2]))
