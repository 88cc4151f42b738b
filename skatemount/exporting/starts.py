"""Start states of a suite's episodes, with the worlds that were drawn for them."""

from __future__ import annotations

import functools
import math
from collections.abc import Collection, Iterator
from typing import Any

import mujoco
import numpy as np
import torch
from torch import Tensor

from skatemount.envs.mount_env import MountEnv
from skatemount.evaluation.evaluator import Evaluator, mix_seeds
from skatemount.exporting.onnx_graph import MEMORY
from skatemount.exporting.world import SENSED, Tap

Arrays = dict[str, np.ndarray]


def tapped(env: MountEnv) -> Tap:
    """Let an environment keep what its sensors show.

    Args:
        env: The environment, before its first reset.

    Returns:
        Its sensors.
    """
    if not isinstance(env.mdp.sensing, Tap):
        tap: Any = Tap(env.mdp.sensing)
        env.mdp.sensing = tap
    return env.mdp.sensing  # type: ignore[return-value]


def record_starts(evaluator: Evaluator, count: int, measurements: Collection[str]) -> tuple[Arrays, dict[str, Tensor]]:
    """Begin the episodes of an evaluation and return all that they begin with.

    Args:
        evaluator: The evaluator of one variant of a suite.
        count: Number of episodes, from the first one on.
        measurements: Names of the measurements that are needed; others that a name stands for are ignored.

    Returns:
        Arrays by name, and the sensors' memory of one world as an example of its shapes. The first dimension of the
        arrays is the episodes: ``state.*`` (fields of ``MjData``), ``model.*`` (fields of ``MjModel`` in which the
        worlds differ from the scene), ``memory.*``, ``sensed.*``, ``start`` (initial x, y and yaw of the trunk in the
        board's frame, m and rad), ``board_fixed`` and, for sampled commands, ``command`` ``[N, T + 1, 3]``. Pushes are
        in rows of their own: ``push.episode``, ``push.step`` and ``push.velocity``, ``[K]``, ``[K]`` and ``[K, 3]``
        m/s, world axes.
    """
    env = evaluator.env
    tap = tapped(env)
    parts: list[Arrays] = []
    worlds = env.num_worlds
    for number in range(math.ceil(count / worlds)):
        env.set_seed(mix_seeds(evaluator.seed, number))
        env.reset()
        rows = min(worlds, count - number * worlds)
        part = _worlds(env, rows)
        part["start"] = _array(env.episode.start[:rows])
        part["board_fixed"] = _array(env.sim.board_fixed[:rows])
        episode = dict(env.episode.items())  # type: ignore[attr-defined]
        known = {f"episode.{name}": value for name, value in episode.items()}
        known |= {f"sensing.{name}": value for name, value in tap.state_dict().items()}
        part |= {MEMORY + name: _array(values[:rows]) for name, values in known.items()}
        measured = tap.measured()
        part |= {SENSED + name: _array(measured[name][:rows]) for name in measurements if name in measured}
        part |= _events(env, rows, number * worlds)
        parts.append(part)
    return _joined(parts, env.physics.model), {name: values[:1].cpu() for name, values in tap.state_dict().items()}


def _array(values: Tensor) -> np.ndarray:
    return values.detach().cpu().numpy().copy()


def _worlds(env: MountEnv, rows: int) -> Arrays:
    """Return the states of the first worlds, and the fields of their models that differ from the scene's."""
    raw, nominal = env.physics.raw_state(), env.physics.model
    states: list[Arrays] = []
    changed: dict[str, dict[int, np.ndarray]] = {}
    for i in range(rows):
        model, state = env.physics.world(i, raw)
        states.append(state)
        for name, values in differences(nominal, model):
            changed.setdefault(name, {})[i] = values.copy()
    part = {f"state.{name}": np.stack([state[name] for state in states]) for name in states[0]}
    for name, by_world in changed.items():
        usual = np.array(getattr(nominal, name))
        part[f"model.{name}"] = np.stack([by_world.get(i, usual) for i in range(rows)])
    return part


def differences(nominal: mujoco.MjModel, model: mujoco.MjModel) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the names and values of a model's arrays that differ from those of another one of the same structure."""
    for name in array_names():
        values = getattr(model, name)
        if not np.array_equal(values, getattr(nominal, name)):
            yield name, values


@functools.cache
def array_names() -> list[str]:
    """Return the names of the arrays of a model."""
    empty = mujoco.MjModel.from_xml_string("<mujoco/>")
    names = (name for name, kind in vars(mujoco.MjModel).items() if isinstance(kind, property))
    return sorted(name for name in names if isinstance(getattr(empty, name), np.ndarray))


@torch.inference_mode()
def _events(env: MountEnv, rows: int, first: int) -> Arrays:
    """Return the pushes and the sampled commands of the episodes that have just begun.

    They are random numbers of the environment and do not depend on the policy, so no physics is needed to draw them:
    the decision process is advanced without.
    """
    pushes, sampled = env._pushes, env.task.config.command.mode == "sampled"
    if not (pushes.active or sampled):
        return {}
    mdp, sim, episode = env.mdp, env.sim, env.episode
    action = torch.zeros(env.num_worlds, mdp.context.layout.num_joints, device=env.device)
    sound = torch.zeros(env.num_worlds, dtype=torch.bool, device=env.device)
    commands = [_array(episode.command[:rows])]
    pushed: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    for step in range(mdp.context.episode_steps):
        if pushes.active:
            due, velocity = pushes.due()
            who = due[:rows].nonzero().squeeze(1)
            pushed.append((_array(who) + first, np.full(len(who), step), _array(velocity[who])))
        mdp.advance(sim, episode, action, sound)
        commands.append(_array(episode.command[:rows]))
    events: Arrays = {}
    if sampled:
        events["command"] = np.stack(commands, 1)
    if pushes.active:
        for name, values in zip(("push.episode", "push.step", "push.velocity"), zip(*pushed)):
            events[name] = np.concatenate(values)
    return events


def _joined(parts: list[Arrays], nominal: mujoco.MjModel) -> Arrays:
    """Concatenate the arrays of several rounds; a field of the model that a round lacks is the scene's there."""
    for name in {name for part in parts for name in part if name.startswith("model.")}:
        usual = np.array(getattr(nominal, name.removeprefix("model.")))
        for part in parts:
            part.setdefault(name, np.repeat(usual[None], len(part["state.qpos"]), 0))
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
