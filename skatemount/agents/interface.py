"""The contract between a policy and its task: what it sees, and what its actions mean."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from skatemount.envs.entities.a1_links import LEGS, LINKS
from skatemount.envs.task import MountTask
from skatemount.runs.checkpoint import PolicyCard
from skatemount.utils.errors import ConfigError

JOINTS = tuple(f"{leg}_{link}" for leg in LEGS for link in LINKS)

ObservationLayout = list[dict[str, Any]]
"""What a policy sees, as `observation_layout` gives it."""


def observation_layout(task: MountTask) -> list[dict[str, Any]]:
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


def action_interface(task: MountTask) -> dict[str, Any]:
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


def check_interface(card: PolicyCard, task: MountTask, where: str = "checkpoint") -> None:
    """Make sure that a policy sees in a task what it was trained to see, and that its actions mean the same.

    Args:
        card: The policy's card.
        task: The task.
        where: What to call the policy in messages.

    Raises:
        ConfigError: They differ; the line says in what.
    """
    theirs, ours = card.observation, observation_layout(task)
    for i in range(max(len(theirs), len(ours))):
        a = theirs[i] if i < len(theirs) else None
        b = ours[i] if i < len(ours) else None
        if a != b:
            raise ConfigError(f"{where}: part {i + 1} of its observation is {_part(a)}, the task gives {_part(b)}")
    check_actions(card, task, where)


def check_actions(card: PolicyCard, task: MountTask, where: str) -> None:
    """Make sure that a policy's actions mean in a task what they meant in training; see `check_interface`."""
    action = action_interface(task)
    for name, value in action.items():
        if card.action.get(name) != value:
            raise ConfigError(f"{where}: its actions have {name}={card.action.get(name)}, the task's {value}")


def _part(part: dict[str, Any] | None) -> str:
    if part is None:
        return "nothing"
    extras = [f"{k}={v}" for k, v in part.items() if k not in ("key", "name")]
    return f"{part.get('key')}.{part.get('name')} ({', '.join(extras)})"


def feature_indices(given: ObservationLayout, card: PolicyCard, key: str, where: str, giver: str) -> Tensor:
    """Where the values that a policy saw in its training are in a vector that shows as much or more.

    Args:
        given: What is shown.
        card: The policy's card.
        key: Of the vector.
        where: What to call the policy in messages.
        giver: What to call whatever shows more.

    Returns:
        One place for each of the policy's values, in its order.

    Raises:
        ConfigError: Something of it is not shown, or not in the same way; the line says what.
    """
    shown, ends, end = {}, {}, 0
    for entry in given:
        if entry["key"] == key:
            end += entry["size"]
            shown[entry["name"]], ends[entry["name"]] = entry, end
    places = []
    for saw in card.observation:
        if saw["key"] != key:
            continue
        name, part = saw["name"], shown.get(saw["name"])
        if part is None or _kind(part) != _kind(saw) or part["size"] < saw["size"]:
            raise ConfigError(f"{where}: it sees {_part(saw)}, {giver} gives {_part(part)}")
        # Of several frames the newest is the last.
        places.append(torch.arange(ends[name] - saw["size"], ends[name]))
    return torch.cat(places)


def _kind(part: dict[str, Any]) -> dict[str, Any]:
    """What must be the same of a part: all but how many frames there are."""
    frames = part.get("history_length", 1)
    return {**part, "size": part["size"] // frames, "history_length": 0}
