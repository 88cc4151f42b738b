"""The folder of an exported policy: graphs, card, scenes, test vectors and start states."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.envs.scene import SceneIndex
from skatemount.envs.task import MountTask
from skatemount.evaluation.evaluator import Evaluator
from skatemount.evaluation.results import in_words
from skatemount.evaluation.suite_task import EvaluationTask
from skatemount.exporting.card import make_card
from skatemount.exporting.mjcf import plain_motors, portable, scene_names
from skatemount.exporting.observe import observe_graph
from skatemount.exporting.onnx_graph import MEMORY, input_shapes, to_bytes
from skatemount.exporting.policy_graph import PolicyFunction, policy_graph, write_torch
from skatemount.exporting.starts import record_starts
from skatemount.exporting.vectors import record_vectors
from skatemount.exporting.world import World, world_graph
from skatemount.runs import atomic
from skatemount.utils.errors import ConfigError, advice

OWN = {"scene": "scene.xml", "observe": "observe.onnx"}
"""Files of the policy's own task, which suites share where theirs are the same."""


@dataclass
class Written:
    """Summary of an export.

    Attributes:
        folder: The folder.
        size: Bytes of all its files.
        starts: Number of start states by suite.
    """

    folder: Path
    size: int
    starts: dict[str, int]


class Folder:
    """A folder that is being filled; files of the same content are written once.

    Args:
        path: The folder.
    """

    def __init__(self, path: Path):
        self.path = path
        self.hashes: dict[str, str] = {}
        self._names: dict[str, str] = {}

    def write(self, name: str, data: bytes) -> str:
        """Write a file, or find the one with the same content.

        Args:
            name: Path in the folder.
            data: Content.

        Returns:
            Path of the file in the folder.
        """
        digest = hashlib.sha256(data).hexdigest()
        if (known := self._names.get(digest)) is not None:
            return known
        file = self.path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        atomic.write_bytes(file, data)
        self.hashes[name] = digest
        self._names[digest] = name
        return name


def check_output(path: Path) -> None:
    """Raise `ConfigError` unless a folder can be made or replaced: it may be empty, or hold an earlier export alone."""
    if path.exists() and not path.is_dir():
        raise ConfigError(f"output={path} is a file; it must name a folder")
    try:
        if not path.exists():
            # Only an attempt tells; the folder itself appears whole or not at all.
            path.mkdir(parents=True)
            path.rmdir()
    except OSError as error:
        raise ConfigError(f"output={path}: {error.strerror}{advice(error)}") from error
    found = [str(each.relative_to(path)) for each in sorted(path.rglob("*")) if each.is_file()]
    written: set[str] = set()
    if "card.json" in found:
        with contextlib.suppress(ValueError, AttributeError, TypeError):  # another program's card.json
            listed = json.loads((path / "card.json").read_text(encoding="utf-8")).get("files", ())
            written = {"card.json", "policy.pt2", *listed}
    if others := [name for name in found if name not in written]:
        raise ConfigError(
            f"output={path} has other files, such as {others[0]}; give a new folder, or that of an earlier export"
        )


def write_folder(
    path: Path,
    agent: TrainedPolicy,
    tasks: Sequence[EvaluationTask],
    starts: int,
    seed: int = 0,
    progress: Callable[[str], None] = lambda doing: None,
) -> Written:
    """Write a policy as graphs that need numpy and onnxruntime alone, with all that is needed to use and to test it.

    Args:
        path: The folder to create or replace.
        agent: The policy.
        tasks: Suites whose start states are written.
        starts: Number of start states of each suite.
        seed: Seed of the test vectors.
        progress: Called with what is done next.

    Raises:
        ConfigError: A part of the policy or of its task cannot be exported.
    """
    progress("networks and observation")
    task = MountTask(config=agent.config)
    function = PolicyFunction(agent.networks, task)
    network, observing = policy_graph(function), observe_graph(task)
    model = task.scene.compile(visuals=False)
    index = SceneIndex.of(task.scene, model)
    card = make_card(agent, task, observing, scene_names(task.scene, model, index))
    with atomic.replacing_folder(path) as staged:
        folder = Folder(staged)
        folder.write(OWN["observe"], to_bytes(observing))
        xml = portable(task.scene.xml())
        folder.write(OWN["scene"], xml.encode())
        folder.write("scene_pd.xml", plain_motors(xml, model, index).encode())
        progress("test vectors")
        folder.write("vectors.npz", packed(record_vectors(function, agent.config, list(input_shapes(observing)), seed)))
        card["suites"] = {}
        for each in tasks if starts else []:
            card["suites"][each.name] = _write_suite(folder, each, starts, progress)
        text = json.dumps(card, ensure_ascii=False)
        folder.write("policy.onnx", to_bytes(network, {"card": text}))
        card["files"] = folder.hashes
        atomic.write_text(staged / "card.json", json.dumps(card, indent=2, ensure_ascii=False) + "\n")
    size = sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
    return Written(path, size, {each.name: starts for each in tasks} if starts else {})


def _write_suite(folder: Folder, task: EvaluationTask, starts: int, progress: Callable[[str], None]) -> dict[str, Any]:
    """Write graphs, scenes and start states of a suite, and return their part of the card."""
    variants = []
    for i, name in enumerate(task.configs):
        count = len(range(i, starts, len(task.configs)))
        if not count:
            continue
        progress(f"{task.name}{f', {name}' if name else ''}")
        evaluator = task.evaluator(name)
        try:
            variants.append({"name": name, **_write_variant(folder, evaluator, f"{task.name}-{i}", count)})
        finally:
            evaluator.close()
    return {
        "version": None if task.suite is None else task.suite.version,
        "description": "the policy's own task" if task.suite is None else task.suite.description,
        "seed": task.seed,
        "changed_by": task.changed_by,
        "episodes": starts,
        "variants": variants,
    }


def _write_variant(folder: Folder, evaluator: Evaluator, stem: str, count: int) -> dict[str, Any]:
    env = evaluator.env
    task, model = env.task, env.physics.model
    observing = observe_graph(task)
    # The limits of a robot need the last three in any case.
    measurements = list(dict.fromkeys([*input_shapes(observing), "joint_pos", "joint_vel", "gravity"]))
    arrays, sensors = record_starts(evaluator, count, measurements)
    judging = world_graph(
        World(task, env.physics.index, env._resistance, env._drive),
        int(model.nsensordata),
        sensors,
        measurements,
        task.config.sensing.encoder_offset > 0,
    )
    needed = input_shapes(judging)
    arrays = {name: values for name, values in arrays.items() if not name.startswith(MEMORY) or name in needed}
    definition = env.mdp.definition
    ends = [definition.failure, *env.mdp.termination_names()]
    return {
        "starts": folder.write(f"suites/{stem}.npz", packed(arrays)),
        "scene": folder.write(f"suites/{stem}.xml", portable(task.scene.xml()).encode()),
        "observe": folder.write(f"suites/{stem}-observe.onnx", to_bytes(observing)),
        "world": folder.write(f"suites/{stem}-world.onnx", to_bytes(judging)),
        "steps": env.mdp.context.episode_steps,
        "ends": ends,
        "end_words": {end: in_words(end, definition) for end in ends},
        "task": definition.name,
        "command": task.config.command.mode,
    }


def packed(arrays: dict[str, np.ndarray]) -> bytes:
    """Return arrays as the content of a compressed ``.npz`` file."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


def write_program(path: Path, agent: TrainedPolicy) -> None:
    """Write a policy as a program of ``torch.export`` with its card.

    Args:
        path: Folder for ``policy.pt2`` and ``card.json``.
        agent: The policy.

    Raises:
        ConfigError: The policy cannot be exported.
    """
    task = MountTask(config=agent.config)
    function = PolicyFunction(agent.networks, task)
    model = task.scene.compile(visuals=False)
    names = scene_names(task.scene, model, SceneIndex.of(task.scene, model))
    card = make_card(agent, task, observe_graph(task), names)
    with atomic.replacing_folder(path) as staged:
        write_torch(function, staged / "policy.pt2")
        atomic.write_text(staged / "card.json", json.dumps(card, indent=2, ensure_ascii=False) + "\n")
