"""`TrainedPolicy`: a policy with the configuration it was trained in, and its card."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from skatemount import config as configuration
from skatemount.agents.interface import action_interface, observation_layout
from skatemount.config import Config
from skatemount.envs.task import MountTask
from skatemount.models.actor_critic import ActorCritic
from skatemount.runs.checkpoint import PolicyCard, load_policy
from skatemount.runs.find import find_checkpoint
from skatemount.runs.provenance import package_versions
from skatemount.runs.shipped import POLICIES, PRETRAINED
from skatemount.utils.errors import ConfigError

if TYPE_CHECKING:
    from skatemount.agents.switching import Policy

MODULE = "networks"
"""Name of the `ActorCritic` among the modules of a policy file: ``save_policy(path, {MODULE: ...})``."""


@dataclass
class TrainedPolicy:
    """A trained policy.

    Attributes:
        networks: Actor and critic.
        config: The whole configuration of its training.
        card: What else is known about it.
        path: Where it was loaded from, a checkpoint folder or a ``.safetensors`` file.
    """

    networks: ActorCritic
    config: Config
    card: PolicyCard
    path: Path

    @classmethod
    def load(cls, spec: str, root: Path | str = "runs", setting: str = "checkpoint") -> TrainedPolicy:
        """Load a policy.

        Args:
            spec: As for `skatemount.runs.find.find_checkpoint`: a checkpoint, file or run, ``latest``,
                ``best`` or ``pretrained:NAME``.
            root: Folder of all runs.
            setting: The setting's name, for messages.

        Returns:
            The policy.

        Raises:
            ConfigError: It is not there, or it does not fit what its card says or this version.
        """
        path = find_checkpoint(spec, root, setting)
        modules, card = load_policy(path)
        config = configuration.from_dict(card.config)
        sizes = {
            key: sum(part.get("size", 0) for part in card.observation if part.get("key") == key)
            for key in ("observation", "privileged")
        }
        networks = ActorCritic(config.network, sizes["observation"], sizes["privileged"])
        load_weights(networks, modules, f"{setting}={spec}")
        return cls(networks, config, card, path)

    @property
    def policy(self) -> Policy:
        """What acts."""
        return self.networks

    def to(self, device: torch.device) -> None:
        """Move what acts to a device."""
        self.networks.to(device)

    @property
    def spec(self) -> str:
        """What loads the same policy again; "latest" may be another one tomorrow."""
        return f"{PRETRAINED}{self.path.stem}" if self.path.parent == POLICIES else str(self.path)

    @property
    def settings(self) -> list[str]:
        """How to ask for it on a command line."""
        return [f"checkpoint={self.spec}"]

    @property
    def name(self) -> str:
        """What to call it: the run's and the checkpoint's name, or the file's."""
        if self.path.parent.name == "checkpoints":
            return f"{self.path.parent.parent.name}/{self.path.name}"
        return self.path.stem


def load_weights(networks: ActorCritic, modules: Mapping[str, Mapping[str, Tensor]], where: str) -> None:
    """Put saved weights into networks.

    Args:
        networks: Where to.
        modules: What `skatemount.runs.checkpoint.load_policy` returned.
        where: What to call the policy in messages.

    Raises:
        ConfigError: A weight is missing, unknown or of another shape; the line says which.
    """
    if MODULE not in modules:
        found = ", ".join(modules) or "nothing"
        raise ConfigError(f"{where}: holds {found}; a policy of this version holds {MODULE!r}")
    saved, own = modules[MODULE], networks.state_dict()
    for key in sorted(own.keys() | saved.keys()):
        if key not in own or key not in saved:
            state = "unknown" if key not in own else "missing"
            raise ConfigError(f"{where}: weight {key} is {state}; its network settings do not fit")
        if saved[key].shape != own[key].shape:
            raise ConfigError(
                f"{where}: weight {key} has shape {list(saved[key].shape)}, "
                f"the network here needs {list(own[key].shape)}"
            )
    networks.load_state_dict(saved)


def make_policy_card(config: Config, task: MountTask, frames: int, metrics: dict[str, Any] | None = None) -> PolicyCard:
    """The card of a policy.

    Args:
        config: The whole configuration of its training.
        task: The task it was trained in.
        frames: Environment steps trained.
        metrics: Training metrics at that moment.
    """
    return PolicyCard(
        stage=config.stage.name,
        config=configuration.to_dict(config),
        observation=observation_layout(task),
        action=action_interface(task),
        frames=frames,
        metrics=dict(metrics or {}),
        versions=package_versions(),
    )
