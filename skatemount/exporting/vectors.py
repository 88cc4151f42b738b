"""Test vectors, with which whoever uses an exported policy checks that it computes the same."""

from __future__ import annotations

import copy

import numpy as np
import torch
from tensordict import TensorDict
from torch import Tensor

from skatemount.config import TrainConfig
from skatemount.envs.mount_env import MountEnv
from skatemount.envs.task import MountTask
from skatemount.exporting import observe
from skatemount.exporting.onnx_graph import MEMORY
from skatemount.exporting.policy_graph import PolicyFunction
from skatemount.exporting.starts import tapped

WORLDS, STEPS = 20, 5
"""Worlds and control steps from which the vectors come."""

POLICY, OBSERVE = "policy.", "observe."
"""Prefixes of the arrays: inputs and outputs of the two graphs."""


def record_vectors(
    function: PolicyFunction, config: TrainConfig, inputs: list[str], seed: int
) -> dict[str, np.ndarray]:
    """Act in the policy's own task for a few steps, and return inputs and outputs of both graphs.

    Args:
        function: The policy.
        config: Settings of its training. The terms' own noise is off here.
        inputs: Names of the inputs of the observation's graph.
        seed: Seed of the worlds.

    Returns:
        ``policy.observation``, ``policy.action`` and ``policy.targets``, and for each input of the observation's graph
        ``observe.<input>``, whose output is ``policy.observation``: `WORLDS` x `STEPS` rows each.
    """
    config = copy.deepcopy(config)
    config.observation.noise = False
    config.physics.engine = "cpu"
    env = MountEnv(MountTask(config=config), num_worlds=WORLDS, threads=1, seed=seed)
    try:
        return _recorded(env, function, inputs)
    finally:
        env.close()


def _recorded(env: MountEnv, function: PolicyFunction, inputs: list[str]) -> dict[str, np.ndarray]:
    tap, rows = tapped(env), list[dict[str, Tensor]]()
    env.reset()
    memory = {
        "action": torch.zeros(env.num_worlds, len(function.pose)),
        "board_direction": torch.zeros_like(env.episode.board_direction),
        "off_time": torch.zeros_like(env.episode.off_time),
        "observation": torch.zeros_like(env.episode.observation),
    }
    for step in range(STEPS):
        episode = env.episode
        with torch.no_grad():
            action, targets = function(episode.observation.clone())
        given = {
            observe.BEGINS: torch.full((env.num_worlds, 1), step == 0),
            observe.COMMAND: episode.command,
            observe.NOISE: torch.zeros(env.num_worlds, observe.frame_size(env.mdp)),
            **tap.measured(),
            **{MEMORY + name: values for name, values in memory.items()},
        }
        rows.append(
            {
                **{OBSERVE + name: given[name].clone() for name in inputs},
                f"{POLICY}observation": episode.observation.clone(),
                f"{POLICY}action": action,
                f"{POLICY}targets": targets,
            }
        )
        memory = {
            "action": action,
            "board_direction": episode.board_direction.clone(),
            "off_time": tap.seen.off_time.clone(),
            "observation": episode.observation.clone(),
        }
        env.step(TensorDict({"action": action}, batch_size=[env.num_worlds]))
    return {name: torch.cat([row[name] for row in rows]).numpy() for name in rows[0]}
