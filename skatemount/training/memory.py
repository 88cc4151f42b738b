"""The memory of a recurrent actor between two iterations, which a collector carries and a checkpoint keeps."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import Transform


def memory_after(batch: TensorDictBase, state_keys: Sequence[str]) -> dict[str, Tensor]:
    """Return what the actor remembers when the next batch begins.

    Args:
        batch: ``[N, T]`` as a collector yields it.
        state_keys: Keys of the memory; see `skatemount.models.base.Networks`.

    Returns:
        ``[N, ...]`` by key, zeros where an episode ended, and ``is_init``, ``[N, 1]`` bool: true where it ended.
    """
    if not state_keys:
        return {}
    ended = batch["next", "done"][:, -1]
    memory = {key: batch["next", key][:, -1] for key in state_keys}
    forgotten = {key: torch.where(ended.view(-1, *[1] * (v.dim() - 1)), 0.0, v) for key, v in memory.items()}
    return forgotten | {"is_init": ended.clone()}


class RestoredMemory(Transform):
    """A transform that gives the actor its memory back at the first reset, when a run resumes.

    Args:
        memory: What `memory_after` returned.
    """

    def __init__(self, memory: dict[str, Tensor]):
        super().__init__()
        self._memory: dict[str, Tensor] | None = memory

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        if self._memory is not None:
            tensordict_reset.update(self._memory)
            self._memory = None
        return tensordict_reset
