"""`Policy`: anything that can act in an environment and be evaluated."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from tensordict import TensorDictBase

from skatemount.envs.mount_env import MountEnv


class Policy(Protocol):
    """A policy that can be evaluated, such as `ActorCritic` or `skatemount.agents.switching.SwitchingPolicy`."""

    def actor_in(self, env: MountEnv) -> Callable[[TensorDictBase], TensorDictBase]:
        """Return a function that acts in an environment from its next reset on.

        Args:
            env: The environment. An actor with memory keeps it for this environment's worlds.

        Returns:
            A function that takes the environment's observations, ``[N]``, and returns them with ``action``,
            ``[N, actions]``.
        """
