"""`TrainedPolicy`: a policy with the settings of its training and its card."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from skatemount import config as configuration
from skatemount.agents.interface import action_interface, observation_layout
from skatemount.agents.policy import Policy
from skatemount.config import TrainConfig
from skatemount.config.plugins import modules_of
from skatemount.envs.task import MountTask
from skatemount.models.base import Networks, make_networks
from skatemount.models.normalization import is_old_count
from skatemount.runs.checkpoint import PolicyCard, load_policy
from skatemount.runs.find import find_checkpoint, is_own_run
from skatemount.runs.provenance import package_versions
from skatemount.runs.shipped import POLICIES, PRETRAINED
from skatemount.utils.errors import ConfigError

MODULE = "networks"
"""Name of the `Networks` among the modules of a policy file: ``save_policy(path, {MODULE: ...})``."""


@dataclass
class TrainedPolicy:
    """A trained policy.

    Attributes:
        networks: Actor and critic.
        config: All settings of its training.
        card: Its card: stage, interface, frames, metrics, versions.
        path: Checkpoint folder or file that it was loaded from.
        own_name: Name that its file has inside, as an ``.onnx`` file has; "" for the name of its path.
    """

    networks: Networks
    config: TrainConfig
    card: PolicyCard
    path: Path
    own_name: str = field(default="", kw_only=True)

    @classmethod
    def load(cls, spec: str, root: Path | str = "runs", setting: str = "checkpoint") -> TrainedPolicy:
        """Load a policy.

        Args:
            spec: A checkpoint, file or run, ``latest``, ``best`` or ``pretrained:NAME``; see
                `skatemount.runs.find.find_checkpoint`.
            root: Folder of all runs.
            setting: Name of the setting that holds ``spec``, for messages.

        Returns:
            The policy.

        Raises:
            ConfigError: There is no such policy, its weights do not fit its card or this version, or it needs plugins
                or a class of networks that are not imported and is not of a run inside ``root``.
        """
        path = find_checkpoint(spec, root, setting)
        if path.suffix == ".onnx":
            from skatemount.agents.onnx_policy import load_onnx  # it needs onnxruntime

            actor, config, card, name = load_onnx(path, f"{setting}={spec}")
            # An actor only: it can be evaluated and filmed, but nothing is trained from it.
            return cls(actor, config, card, path, own_name=name)  # type: ignore[arg-type]
        modules, card = load_policy(path)
        where = f"{setting}={spec}: saved settings"
        config = configuration.from_dict(card.config, own=is_own_run(path, root), where=where)
        sizes = {
            key: sum(part.get("size", 0) for part in card.observation if part.get("key") == key)
            for key in ("observation", "privileged")
        }
        joints = card.action.get("joints")
        if not joints:
            raise ConfigError(f"{setting}={spec}: action.joints of its card must name the joints that its actions move")
        networks = make_networks(config.network, sizes["observation"], sizes["privileged"], len(joints))
        load_weights(networks, modules, f"{setting}={spec}")
        return cls(networks, config, card, path)

    @property
    def policy(self) -> Policy:
        """The policy that acts."""
        return self.networks

    def to(self, device: torch.device) -> None:
        """Move the networks to a device."""
        self.networks.to(device)

    @property
    def spec(self) -> str:
        """Specification that loads this policy again, unlike ``latest``, which changes."""
        return f"{PRETRAINED}{self.path.stem}" if self.path.parent == POLICIES else str(self.path)

    @property
    def settings(self) -> list[str]:
        """Settings that name it on a command line."""
        return [f"checkpoint={self.spec}"]

    @property
    def modules(self) -> list[str]:
        """Modules of the user that it needs."""
        return modules_of(self.config, training=False)

    @property
    def name(self) -> str:
        """Name for tables and files: its own, run and checkpoint, or the file's name."""
        if self.own_name:
            return self.own_name
        if self.path.parent.name == "checkpoints":
            return f"{self.path.parent.parent.name}/{self.path.name}"
        return self.path.stem


def load_weights(networks: Networks, modules: Mapping[str, Mapping[str, Tensor]], where: str) -> None:
    """Load saved weights into networks.

    Args:
        networks: The networks to load into.
        modules: Saved modules, as `skatemount.runs.checkpoint.load_policy` returns them.
        where: Name of the policy in messages.

    Raises:
        ConfigError: A weight is missing, unknown or has another shape; the message names it.
    """
    if MODULE not in modules:
        found = ", ".join(modules) or "nothing"
        raise ConfigError(f"{where}: holds {found}; a policy of this version holds {MODULE!r}")
    saved, own = modules[MODULE], networks.state_dict()
    for key in sorted(own.keys() | saved.keys()):
        if key not in own or key not in saved:
            state = "unknown" if key not in own else "missing"
            raise ConfigError(f"{where}: weight {key} is {state}; its network settings do not fit")
        if saved[key].shape != own[key].shape and not is_old_count(key, saved[key]):
            raise ConfigError(
                f"{where}: weight {key} has shape {list(saved[key].shape)}, "
                f"the network here needs {list(own[key].shape)}"
            )
    networks.load_state_dict(saved)


def make_policy_card(
    config: TrainConfig, task: MountTask, frames: int, metrics: dict[str, Any] | None = None
) -> PolicyCard:
    """Return the card of a policy.

    Args:
        config: All settings of its training.
        task: The task it was trained in.
        frames: Number of environment steps trained.
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
