"""Small networks, a learner for them, and random batches, for tests of losses."""

from __future__ import annotations

from typing import Any

import defaults
import torch
from tensordict import TensorDict
from torch import Tensor

from skatemount.losses.ppo import PPO
from skatemount.models.actor_critic import ActorCritic

STEP = 0.04
OBSERVATION, PRIVILEGED, ACTIONS = 6, 3, 4


def make_networks(seed: int = 0, **settings: Any) -> ActorCritic:
    torch.manual_seed(seed)
    config = defaults.network(actor=[32], critic=[32], **settings)
    return ActorCritic(config, OBSERVATION, PRIVILEGED, ACTIONS)


def make(
    networks: ActorCritic | None = None, bf16: bool = False, order: torch.Generator | None = None, **settings: Any
) -> PPO:
    order = order or torch.Generator().manual_seed(7)
    config = defaults.algorithm(**settings)
    return PPO(config, networks or make_networks(), STEP, bf16=bf16, generator=order)


def flags(n: int, t: int, share: float, generator: torch.Generator) -> Tensor:
    return torch.rand(n, t, 1, generator=generator) < share


def collect(networks: ActorCritic, n: int = 16, t: int = 12, seed: int = 0, ends: float = 0.1) -> TensorDict:
    """Return a batch as a collector yields it: a step's next state is the following state unless the episode ended."""
    generator = torch.Generator().manual_seed(seed)
    torch.manual_seed(seed)
    terminated = flags(n, t, ends, generator)
    truncated = flags(n, t, ends, generator) & ~terminated
    batch = TensorDict(batch_size=[n, t])
    done = terminated | truncated
    following = TensorDict(batch_size=[n, t])
    for key, size in (("observation", OBSERVATION), ("privileged", PRIVILEGED)):
        now = 3.0 * torch.randn(n, t, size, generator=generator) + 1.0
        after = 3.0 * torch.randn(n, t, size, generator=generator) + 1.0
        after[:, :-1] = torch.where(done[:, :-1], after[:, :-1], now[:, 1:])
        batch[key], following[key] = now, after
    with torch.no_grad():
        networks.actor(batch)
    reward = torch.randn(n, t, 1, generator=generator)
    batch["next"] = following.update(dict(reward=reward, done=done, terminated=terminated, truncated=truncated))
    return batch


def weights(networks: ActorCritic) -> dict[str, Tensor]:
    return {key: value.clone() for key, value in networks.state_dict().items()}


def same(a: dict[str, Tensor], b: dict[str, Tensor]) -> bool:
    return a.keys() == b.keys() and all(torch.equal(a[key], b[key]) for key in a)
