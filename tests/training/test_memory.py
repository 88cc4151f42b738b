"""The memory of a recurrent actor survives the end of a batch, but not the end of an episode."""

from __future__ import annotations

import torch
from tensordict import TensorDict

from skatemount.training.memory import RestoredMemory, memory_after


def batch() -> TensorDict:
    """Return two worlds and three steps; the second world's episode ends in the last step."""
    done = torch.tensor([[[False], [True], [False]], [[False], [False], [True]]])
    memory = torch.arange(12.0).view(2, 3, 1, 2)
    return TensorDict({"next": TensorDict({"done": done, "memory": memory}, [2, 3])}, [2, 3])


def test_an_ended_episode_is_forgotten() -> None:
    kept = memory_after(batch(), ["memory"])
    assert kept["memory"].tolist() == [[[4.0, 5.0]], [[0.0, 0.0]]]
    assert kept["is_init"].tolist() == [[False], [True]]
    assert memory_after(batch(), []) == {}


def test_the_first_reset_gives_the_memory_back() -> None:
    restored = RestoredMemory({"memory": torch.ones(2, 1)})
    first = restored._reset(TensorDict({}, [2]), TensorDict({"memory": torch.zeros(2, 1)}, [2]))
    assert first["memory"].tolist() == [[1.0], [1.0]]
    second = restored._reset(TensorDict({}, [2]), TensorDict({"memory": torch.zeros(2, 1)}, [2]))
    assert second["memory"].tolist() == [[0.0], [0.0]]
