"""A policy from an ONNX file, of this project or of another one, behind the interface of a trained policy."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase

from skatemount import config as configuration
from skatemount.agents.interface import action_interface, observation_layout
from skatemount.envs.mount_env import MountEnv
from skatemount.envs.task import MountTask
from skatemount.runner.folder import Graph, RunnerError
from skatemount.runs.checkpoint import PolicyCard
from skatemount.utils.errors import ConfigError, check_name


class OnnxActor:
    """A graph with the input ``observation`` and the output ``action``; see `skatemount.agents.policy.Policy`.

    Args:
        graph: The graph.
    """

    def __init__(self, graph: Graph):
        self._graph = graph

    def to(self, device: torch.device) -> OnnxActor:
        """Return the actor itself, which computes on the CPU for worlds on any device."""
        return self

    def actor_in(self, env: MountEnv) -> Callable[[TensorDictBase], TensorDictBase]:
        """Return a function that writes the graph's actions."""

        def act(state: TensorDictBase) -> TensorDictBase:
            observation = state["observation"]
            action = self._graph({"observation": np.asarray(observation.cpu(), np.float32)})["action"]
            return state.update({"action": torch.from_numpy(action).to(observation.device)})

        return act


def load_onnx(path: Path, where: str) -> tuple[OnnxActor, Any, PolicyCard, str]:
    """Load a policy from an ONNX file whose metadata has a card.

    Args:
        path: The file. Its text ``card`` is JSON with ``settings``, all settings of a training, which name the
            observation, the robot, and the control rate, and ``policy`` with its ``name``, which may be missing.
        where: Name of the policy in messages.

    Returns:
        The actor, the settings, the card, and the policy's name; "" without one.

    Raises:
        ConfigError: The file cannot be read, has no card, or its sizes are not those of the card's task,
            or its name cannot be part of a file's name.
    """
    try:
        graph = Graph(path)
    except RunnerError as error:
        raise ConfigError(f"{where}: {error}") from error
    if "observation" not in graph.shapes or "action" not in graph.outputs:
        raise ConfigError(f"{where}: needs an input observation and an output action; it has {', '.join(graph.shapes)}")
    try:
        card = json.loads(graph.metadata["card"])
        settings, policy = card["settings"], dict(card.get("policy", {}))
    except (KeyError, ValueError, TypeError, AttributeError) as error:
        raise ConfigError(
            f"{where}: its metadata has no card with settings; docs/export.md says how to add one"
        ) from error
    # "run/checkpoint" is a name, too; files of it have no slash.
    name = str(policy.get("name", ""))
    check_name(f"{where}: policy.name of its card", name.replace("/", "_"))
    config = configuration.from_dict(settings, own=False, where=f"{where}: settings of its card")
    task = MountTask(config=config)
    layout = observation_layout(task)
    size = sum(part["size"] for part in layout if part["key"] == "observation")
    if graph.shapes["observation"][1:] != [size]:
        raise ConfigError(
            f"{where}: reads observations of shape {graph.shapes['observation'][1:]}, the settings of its card give "
            f"{size} values"
        )
    stage = str(policy.get("stage", config.stage.name))
    made = PolicyCard(
        stage=stage,
        config=configuration.to_dict(config),
        observation=layout,
        action=action_interface(task),
        frames=int(policy.get("frames", 0)),
        versions=dict(card.get("versions", {})),
        sha256=str(policy.get("weights_sha256", "")),
    )
    return OnnxActor(graph), config, made, name


def add_card(model: Path, output: Path, settings: dict[str, Any], name: str) -> None:
    """Write an ONNX file with a card, so that ``checkpoint=<file>.onnx`` evaluates and films it.

    Args:
        model: ONNX file with the input ``observation``, ``[N, D]``, and the output ``action``, ``[N, J]``.
        output: File to write.
        settings: All settings, as `skatemount.config.to_dict` gives those that `skatemount.config.compose` composes.
        name: Name of the policy.
    """
    import onnx

    made = onnx.load(str(model))
    kept = {entry.key: entry.value for entry in made.metadata_props}
    onnx.helper.set_model_props(made, kept | {"card": json.dumps({"policy": {"name": name}, "settings": settings})})
    onnx.save(made, str(output))
