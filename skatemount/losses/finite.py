"""The check that a batch and the weights are finite, before an update."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase

from skatemount.losses.base import NotFinite
from skatemount.models.base import Networks


def check_finite(networks: Networks, batch: TensorDictBase) -> None:
    """Raise `NotFinite` for values that are not finite, which would stay in the normalizers forever.

    The error names the first cause: a weight, then the earliest step of the batch, in the order of a step.

    Args:
        networks: Actor and critic.
        batch: ``[N, T]`` as a TorchRL collector yields it.

    Raises:
        FloatingPointError: A weight is not finite.
        NotFinite: A value of the batch is not finite.
    """
    for name, weights in networks.named_parameters():
        if not bool(torch.isfinite(weights).all()):
            raise FloatingPointError(f"weight {name} is not finite")
    seen = dict.fromkeys([*networks.critic_keys, *networks.actor_keys])
    order = [*seen, "action", *(("next", key) for key in seen), ("next", "reward")]
    broken = {key: ~torch.isfinite(batch[key]).flatten(2).all(2) for key in order}
    if not any(bool(flags.any()) for flags in broken.values()):
        return
    key = min((key for key in order if broken[key].any()), key=lambda k: int(broken[k].any(0).int().argmax()))
    step = int(broken[key].any(0).int().argmax())
    worlds = broken[key].any(1)
    world = int(broken[key][:, step].int().argmax())
    raise NotFinite(
        f"{key if isinstance(key, str) else '.'.join(key)} is not finite in {int(worlds.sum())} of {len(worlds)} "
        f"worlds, first in world {world} at step {step} of the batch",
        key if isinstance(key, str) else key[-1],
        ~torch.isfinite(batch[key][:, step]).all(0),
    )
