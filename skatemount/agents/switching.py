"""Two policies one after the other, as in the paper: one walks up to the board, the other mounts it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from skatemount.agents.interface import feature_indices
from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.envs.mount_env import MountEnv
from skatemount.models.actor_critic import ActorCritic
from skatemount.runs.shipped import PRETRAINED, shipped_file
from skatemount.utils.errors import ConfigError

MARGIN = 0.3
"""How much farther than the switch_distance the robot must be for the walking policy to take over again, m."""


@dataclass
class SwitchingPolicy:
    """A walking and a mounting policy that take turns in each world.

    The walking policy follows the velocity command that the environment computes from the board's pose
    (`skatemount.envs.commands.toward_board`). The mounting policy sees the whole observation.

    Attributes:
        walk: The walking policy.
        mount: The mounting policy.
        walker_features: ``[D]``, which values of the observation the walking policy sees, in its order.
        switch_distance: Distance between trunk and deck's centre in the plane at which the mounting policy takes over,
            m.
    """

    walk: ActorCritic
    mount: ActorCritic
    walker_features: Tensor
    switch_distance: float

    def actor_in(self, env: MountEnv) -> Callable[[TensorDictBase], TensorDictBase]:
        """What acts in an environment from its next reset on; it remembers whose turn it is in each world.

        Args:
            env: The environment.
        """
        mounting = torch.zeros(env.num_worlds, dtype=torch.bool, device=env.device)

        def act(seen: TensorDictBase) -> TensorDictBase:
            nonlocal mounting
            distance = env.episode.distance
            mounting = (distance < self.switch_distance) | (mounting & (distance < self.switch_distance + MARGIN))
            walked = self.walk.actor(TensorDict(observation=seen["observation"][:, self.walker_features]))
            acted = self.mount.actor(seen)
            acted["action"] = torch.where(mounting.unsqueeze(1), acted["action"], walked["action"])
            return acted

        return act


Policy = ActorCritic | SwitchingPolicy
"""What can be evaluated."""


@dataclass
class SwitchingAgent(TrainedPolicy):
    """Two policies that are tried as one; configuration, card and path are the mounting policy's.

    Attributes:
        walker: The walking policy.
        walker_features: See `SwitchingPolicy`.
        switch_distance: See `SwitchingPolicy`.
    """

    walker: TrainedPolicy
    walker_features: Tensor
    switch_distance: float

    @property
    def name(self) -> str:
        """What to call it."""
        return f"{self.walker.name}+{super().name}"

    def to(self, device: torch.device) -> None:
        """Move what acts to a device."""
        super().to(device)
        self.walker.to(device)
        self.walker_features = self.walker_features.to(device)

    @property
    def policy(self) -> SwitchingPolicy:
        """What acts."""
        return SwitchingPolicy(self.walker.networks, self.networks, self.walker_features, self.switch_distance)

    @property
    def settings(self) -> list[str]:
        """How to ask for it on a command line."""
        return [f"pipeline={self.walker.spec}+{self.spec}", f"switch_distance={self.switch_distance}"]

    @classmethod
    def load_pair(cls, spec: str, switch_distance: float, root: Path | str = "runs") -> SwitchingAgent:
        """Load two policies.

        Args:
            spec: ``WALK+MOUNT``, each the name of a shipped policy or anything that ``checkpoint`` may be.
            switch_distance: See `SwitchingPolicy`.
            root: Folder of all runs.

        Raises:
            ConfigError: Not two policies, or the first one sees something that the second one does not, or they do not
                act alike.
        """
        names = spec.split("+")
        if len(names) != 2 or not all(names):
            raise ConfigError(f"pipeline={spec} must be two policies, WALK+MOUNT, such as gait+mount")
        walker, mounter = (
            TrainedPolicy.load(f"{PRETRAINED}{name}" if shipped_file(name) else name, root, "pipeline")
            for name in names
        )
        if walker.card.action != mounter.card.action:
            raise ConfigError(
                f"pipeline={spec}: the cards of {names[0]} and {names[1]} differ in action; policies that take turns "
                "must act alike"
            )
        where = f"pipeline={spec}: the first policy must see no more than the second; {names[0]}"
        seen = feature_indices(mounter.card.observation, walker.card, "observation", where, names[1])
        return cls(**vars(mounter), walker=walker, walker_features=seen, switch_distance=switch_distance)
