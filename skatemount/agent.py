"""`Agent`: a policy with the configuration it was trained in, and the contract it keeps with its task."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from skatemount import config as configuration
from skatemount.checkpoint import Card, load_policy
from skatemount.config import Config
from skatemount.envs.scene import LEGS
from skatemount.envs.task import MountTask
from skatemount.errors import ConfigError
from skatemount.models import ActorCritic
from skatemount.provenance import package_versions
from skatemount.runs import POLICIES, PRETRAINED, find_checkpoint

if TYPE_CHECKING:
    from skatemount.benchmark.pipeline import Policy

MODULE = "networks"
"""Name of the `ActorCritic` among the modules of a policy file: ``save_policy(path, {MODULE: ...})``."""

JOINTS = tuple(f"{leg}_{joint}" for leg in LEGS for joint in ("hip", "thigh", "calf"))


@dataclass
class Agent:
    """A trained policy.

    Attributes:
        networks: Actor and critic.
        config: The whole configuration of its training.
        card: What else is known about it.
        path: Where it was loaded from, a checkpoint folder or a ``.safetensors`` file.
    """

    networks: ActorCritic
    config: Config
    card: Card
    path: Path

    @classmethod
    def load(cls, spec: str, root: Path | str = "runs", setting: str = "checkpoint") -> Agent:
        """Load a policy.

        Args:
            spec: As for `skatemount.runs.find_checkpoint`: a checkpoint, file or run, ``latest``,
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
        modules: What `skatemount.checkpoint.load_policy` returned.
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


def observation_contract(task: MountTask) -> list[dict[str, Any]]:
    """What a policy for a task sees.

    Args:
        task: The task.

    Returns:
        For each part in order: the ``key`` of the vector it is in (``observation``, or
        ``privileged`` for what only the critic sees), its name, size and scale, and clip and
        parameters where it has any.
    """
    mdp, settings = task.make_mdp(torch.Generator()), task.config.observation
    parts = []
    for key, table, terms in (
        ("observation", mdp.observation, settings.policy),
        ("privileged", mdp.privileged, settings.privileged),
    ):
        for entry in table.layout():
            term = terms[entry["name"]]
            part = {"key": key, **entry}
            if term.clip is not None:
                part["clip"] = float(term.clip)
            if term.params:
                part["params"] = dict(term.params)
            parts.append(part)
    return parts


def action_contract(task: MountTask) -> dict[str, Any]:
    """What the actions of a policy for a task mean.

    Args:
        task: The task.

    Returns:
        ``joints`` in order; the target of each is ``default_pose + scale * action`` in rad with
        the action limited to ``clip``; ``control_step`` is the time between two actions, s.
    """
    robot = task.scene.robot
    return {
        "joints": list(JOINTS),
        "default_pose": [round(float(x), 6) for x in robot.default_pose],
        "scale": [round(float(x), 6) for x in robot.action_scale],
        "clip": float(robot.config.action_clip),
        "control_step": round(task.scene.solver.control_step, 6),
    }


def make_card(config: Config, task: MountTask, frames: int, metrics: dict[str, Any] | None = None) -> Card:
    """The card of a policy.

    Args:
        config: The whole configuration of its training.
        task: The task it was trained in.
        frames: Environment steps trained.
        metrics: Training metrics at that moment.
    """
    return Card(
        stage=config.stage.name,
        config=configuration.to_dict(config),
        observation=observation_contract(task),
        action=action_contract(task),
        frames=frames,
        metrics=dict(metrics or {}),
        versions=package_versions(),
    )


def check_contract(card: Card, task: MountTask, where: str = "checkpoint") -> None:
    """Make sure that a policy sees in a task what it was trained to see, and that its actions mean the same.

    Args:
        card: The policy's card.
        task: The task.
        where: What to call the policy in messages.

    Raises:
        ConfigError: They differ; the line says in what.
    """
    theirs, ours = card.observation, observation_contract(task)
    for i in range(max(len(theirs), len(ours))):
        a = theirs[i] if i < len(theirs) else None
        b = ours[i] if i < len(ours) else None
        if a != b:
            raise ConfigError(f"{where}: part {i + 1} of its observation is {_part(a)}, the task gives {_part(b)}")
    check_actions(card, task, where)


def check_actions(card: Card, task: MountTask, where: str) -> None:
    """Make sure that a policy's actions mean in a task what they meant in training; see `check_contract`."""
    action = action_contract(task)
    for name, value in action.items():
        if card.action.get(name) != value:
            raise ConfigError(f"{where}: its actions have {name}={card.action.get(name)}, the task's {value}")


def _part(part: dict[str, Any] | None) -> str:
    if part is None:
        return "nothing"
    extras = [f"{k}={v}" for k, v in part.items() if k not in ("key", "name")]
    return f"{part.get('key')}.{part.get('name')} ({', '.join(extras)})"
