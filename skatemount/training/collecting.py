"""The collector of a training: TorchRL's, over the worlds of this process."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from tensordict import TensorDictBase
from torch import Tensor
from torchrl.collectors import Collector
from torchrl.envs import Compose, EnvBase, TransformedEnv

from skatemount.envs import MountEnv
from skatemount.models.base import Networks
from skatemount.training.memory import RestoredMemory
from skatemount.utils.devices import on_threads, rng_state, set_rng_state


@contextmanager
def collecting(
    env: MountEnv, networks: Networks, memory: dict[str, Tensor], steps: int, resumes: bool
) -> Iterator[Iterator[TensorDictBase]]:
    """Yield batches ``[N, T]`` of an environment without an end, for a ``with`` block.

    Args:
        env: The environment; it stays open.
        networks: The networks, whose actor acts.
        memory: What the actor remembers at the beginning; see `skatemount.training.memory`.
        steps: Control steps of a batch, T.
        resumes: The training resumes, so that torch's random state must stay as it is.
    """
    device = env.physics.device
    restored = rng_state(device)
    collected: EnvBase = env
    if transforms := networks.transforms():
        # They carry the actor's memory from step to step, and reset it with a world.
        collected = TransformedEnv(env, Compose(*transforms, RestoredMemory(memory)))
    collector = Collector(
        collected,
        networks.actor,
        frames_per_batch=env.num_worlds * steps,
        total_frames=-1,
        track_traj_ids=False,
        auto_register_policy_transforms=False,
    )
    if resumes:
        # The collector tries the policy out, which draws random actions.
        set_rng_state(restored, device)
    try:
        yield on_threads(collector, env.torch_threads)
    finally:
        collector.shutdown(close_env=False)
