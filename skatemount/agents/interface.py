"""The interface between a policy and a task: the layout of the observation, and the meaning of the actions."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from skatemount.config.files import choices, robot_of
from skatemount.config.versions import upgrade
from skatemount.envs.task import MountTask
from skatemount.runs.checkpoint import PolicyCard
from skatemount.utils.errors import ConfigError

ObservationLayout = list[dict[str, Any]]
"""The terms of the observation in order, as `observation_layout` returns them."""


def observation_layout(task: MountTask) -> ObservationLayout:
    """Return the layout of a task's observation.

    Args:
        task: The task.

    Returns:
        An entry for each term in order: the ``key`` of its vector (``observation``, or ``privileged`` for what only the
        critic reads), its ``name``, ``size`` and ``scale``, and its clip and parameters if it has any.
    """
    mdp, settings = task.make_mdp(torch.Generator()), task.config.observation
    layout = []
    for key, table, terms in (
        ("observation", mdp.observation, settings.policy),
        ("privileged", mdp.privileged, settings.privileged),
    ):
        for entry in table.layout():
            term = terms[entry["name"]]
            described = {"key": key, **entry}
            if term.clip is not None:
                described["clip"] = float(term.clip)
            if term.params:
                described["params"] = dict(term.params)
            layout.append(described)
    return layout


def action_interface(task: MountTask) -> dict[str, Any]:
    """Return the meaning of the actions in a task.

    Args:
        task: The task.

    Returns:
        ``joints`` in order. The target of each is ``default_pose + scale * action`` in rad, with the action limited to
        ``clip``. ``control_step`` is the time between two actions, s.
    """
    robot = task.scene.robot
    return {
        "joints": list(robot.layout.joints),
        "default_pose": [round(float(x), 6) for x in robot.default_pose],
        "scale": [round(float(x), 6) for x in robot.action_scale],
        "clip": float(robot.config.action_clip),
        "control_step": round(task.scene.solver.control_step, 6),
    }


def check_interface(card: PolicyCard, task: MountTask, where: str = "checkpoint", other_robot: bool = False) -> None:
    """Check that a task gives the observation that a policy was trained with, and that actions mean the same.

    Args:
        card: The policy's card.
        task: The task.
        where: Name of the policy in messages.
        other_robot: Allow another robot with the same joints.

    Raises:
        ConfigError: They differ; the message names the robot if that is another one, or else the first difference.
    """
    check_actions(card, task, where, other_robot)
    theirs, ours = card.observation, observation_layout(task)
    for i in range(max(len(theirs), len(ours))):
        a = theirs[i] if i < len(theirs) else None
        b = ours[i] if i < len(ours) else None
        if a != b:
            raise ConfigError(f"{where}: part {i + 1} of its observation is {_words(a)}, the task gives {_words(b)}")


def check_actions(card: PolicyCard, task: MountTask, where: str, other_robot: bool = False) -> None:
    """Check that actions mean in a task what they meant in a policy's training; see `check_interface`."""
    action = action_interface(task)
    own = _OF_A_ROBOT if other_robot and _other_robot(card, task) else ()
    for name, value in action.items():
        if card.action.get(name) != value and name not in own:
            problem = (
                f"its actions have {name}={card.action.get(name)}, the task's {value}{_other_settings(card, task)}"
            )
            raise ConfigError(f"{where}: {_other_robot(card, task) or problem}")


def _other_robot(card: PolicyCard, task: MountTask) -> str | None:
    """Return that a policy was trained with another robot, and how to choose that one; None if it was not."""
    theirs, ours = _saved(card).get("robot", {}).get("variant"), task.config.robot.variant
    if theirs is None or theirs == ours:
        return None
    files = [name for name in choices("robot") if robot_of(name) == theirs]
    if theirs in files:
        files = [theirs]
    choice = f"robot={files[0]}" if files else f"robot.variant={theirs}"
    return f"it was trained with another robot, {theirs}, than the task's {ours}; give {choice}"


def _other_settings(card: PolicyCard, task: MountTask) -> str:
    """Return how to give the settings behind the meaning of actions the values of a policy's training."""
    saved = _saved(card)
    found = []
    for group, names in _BEHIND_ACTIONS.items():
        for name in names:
            value = saved.get(group, {}).get(name)
            if value is not None and value != getattr(getattr(task.config, group), name):
                found.append(f"{group}.{name}={value}")
    return f"; give {' '.join(found)}" if found else ""


_OF_A_ROBOT = ("default_pose", "scale")
"""Parts of `action_interface` that differ between robots with the same joints."""

_BEHIND_ACTIONS = {
    "robot": (
        *("hip_inward", "thigh", "calf"),
        *("action_scale_hip", "action_scale_thigh", "action_scale_calf", "action_clip"),
    ),
    "physics": ("timestep", "substeps"),
}
"""Settings that `action_interface` follows from, by their group."""


def _saved(card: PolicyCard) -> dict[str, Any]:
    """Return the settings of a policy's training under today's names."""
    return upgrade(card.config)


def _words(entry: dict[str, Any] | None) -> str:
    """Return an entry of a layout as words for a message."""
    if entry is None:
        return "nothing"
    extras = [f"{k}={v}" for k, v in entry.items() if k not in ("key", "name")]
    return f"{entry.get('key')}.{entry.get('name')} ({', '.join(extras)})"


def feature_indices(given: ObservationLayout, needed: ObservationLayout, key: str, where: str, giver: str) -> Tensor:
    """Return the indices of a policy's inputs in a vector with the same or more terms.

    Args:
        given: Layout of the vector.
        needed: Layout of what the policy reads.
        key: ``observation`` or ``privileged``.
        where: Name of the policy in messages.
        giver: Name in messages of what the vector belongs to.

    Returns:
        ``[D]`` int64, an index for each of the policy's inputs, in its order.

    Raises:
        ConfigError: A term is missing, or is not the same; the message names it.
    """
    shown, ends, end = {}, {}, 0
    for entry in given:
        if entry["key"] == key:
            end += entry["size"]
            shown[entry["name"]], ends[entry["name"]] = entry, end
    indices = []
    for entry in needed:
        if entry["key"] != key:
            continue
        name = entry["name"]
        found = shown.get(name)
        if found is None or _without_frames(found) != _without_frames(entry) or found["size"] < entry["size"]:
            raise ConfigError(f"{where}: it reads {_words(entry)}, {giver} gives {_words(found)}")
        # The newest of several frames is the last.
        indices.append(torch.arange(ends[name] - entry["size"], ends[name]))
    return torch.cat(indices)


def _without_frames(entry: dict[str, Any]) -> dict[str, Any]:
    """Return an entry of a layout as if it had one frame, for comparison."""
    frames = entry.get("history_length", 1)
    return {**entry, "size": entry["size"] // frames, "history_length": 0}
