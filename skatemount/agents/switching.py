"""Two policies that take turns, as in the paper: one walks up to the board, the other mounts it."""

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
from skatemount.models.base import Networks
from skatemount.runs.shipped import PRETRAINED, shipped_file
from skatemount.utils.errors import ConfigError

MARGIN = 0.3
"""Distance beyond ``switch_distance`` at which the walking policy takes over again, m."""


@dataclass
class SwitchingPolicy:
    """A walking and a mounting policy that take turns in each world, by the distance from the board.

    The walking policy follows the velocity command that the environment computes from the board's pose
    (`skatemount.envs.commands.toward_board`). The mounting policy reads the whole observation.

    Attributes:
        walker: The walking policy.
        mounter: The mounting policy.
        walker_indices: ``[D]`` int64, indices into the observation of the entries that the walking policy reads, in its
            order.
        switch_distance: Horizontal distance between trunk and deck's center below which the mounting policy acts, m.
    """

    walker: Networks
    mounter: Networks
    walker_indices: Tensor
    switch_distance: float

    def actor_in(self, env: MountEnv) -> Callable[[TensorDictBase], TensorDictBase]:
        """Return an actor that remembers which policy acts in each world; see `skatemount.agents.policy.Policy`."""
        mounting = torch.zeros(env.num_worlds, dtype=torch.bool, device=env.device)
        # Both act in every step, so that a policy with memory keeps it while the other one is in control.
        walk, mount = self.walker.actor_in(env), self.mounter.actor_in(env)

        def act(state: TensorDictBase) -> TensorDictBase:
            nonlocal mounting
            distance = env.episode.distance
            mounting = (distance < self.switch_distance) | (mounting & (distance < self.switch_distance + MARGIN))
            walking = walk(TensorDict(observation=state["observation"][:, self.walker_indices]))
            result = mount(state)
            result["action"] = torch.where(mounting.unsqueeze(1), result["action"], walking["action"])
            return result

        return act


@dataclass
class SwitchingAgent(TrainedPolicy):
    """Two trained policies that are evaluated as one. Settings, card and path are those of the mounting policy.

    Attributes:
        walker: The walking policy.
        walker_indices: See `SwitchingPolicy`.
        switch_distance: See `SwitchingPolicy`.
    """

    walker: TrainedPolicy
    walker_indices: Tensor
    switch_distance: float

    @property
    def name(self) -> str:
        """Name for tables and files: the names of both policies."""
        return f"{self.walker.name}+{super().name}"

    def to(self, device: torch.device) -> None:
        """Move both policies to a device."""
        super().to(device)
        self.walker.to(device)
        self.walker_indices = self.walker_indices.to(device)

    @property
    def policy(self) -> SwitchingPolicy:
        """The policy that acts."""
        return SwitchingPolicy(self.walker.networks, self.networks, self.walker_indices, self.switch_distance)

    @property
    def modules(self) -> list[str]:
        """Modules of the user that the policies need."""
        return list(dict.fromkeys([*self.walker.modules, *super().modules]))

    @property
    def settings(self) -> list[str]:
        """Settings that name it on a command line."""
        return [f"pipeline={self.walker.spec}+{self.spec}", f"switch_distance={self.switch_distance}"]

    @classmethod
    def load_pair(cls, spec: str, switch_distance: float, root: Path | str = "runs") -> SwitchingAgent:
        """Load two policies.

        Args:
            spec: ``WALK+MOUNT``, each the name of a shipped policy or anything that ``checkpoint`` may be.
            switch_distance: See `SwitchingPolicy`.
            root: Folder of all runs.

        Raises:
            ConfigError: ``spec`` does not name two policies, the first one reads something that the second one does
                not, or their actions differ in meaning.
        """
        names = spec.split("+")
        if len(names) != 2 or not all(names):
            raise ConfigError(f"pipeline={spec} must be two policies, WALK+MOUNT, such as gait+mount")
        try:
            walker, mounter = (
                TrainedPolicy.load(f"{PRETRAINED}{name}" if shipped_file(name) else name, root, "pipeline")
                for name in names
            )
        except ConfigError as error:
            raise ConfigError(f"pipeline={spec}: {str(error).removeprefix('pipeline=')}") from error
        if walker.card.action != mounter.card.action:
            raise ConfigError(
                f"pipeline={spec}: the actions of {names[0]} and {names[1]} have different meanings (joints, pose, "
                "scale, clip or control step); policies that take turns need the same"
            )
        where = f"pipeline={spec}: the first policy may read only what the second one reads; {names[0]}"
        indices = feature_indices(mounter.card.observation, walker.card.observation, "observation", where, names[1])
        return cls(**vars(mounter), walker=walker, walker_indices=indices, switch_distance=switch_distance)
