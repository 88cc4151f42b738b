"""A small exported policy that several tests share, with recordings of the torch version's episodes."""

from __future__ import annotations

import copy
import functools
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict

import skatemount.envs.observations.table as observation_table
import skatemount.envs.sensing as sensing
from skatemount.agents.trained_policy import MODULE, TrainedPolicy, make_policy_card
from skatemount.config import TrainConfig, compose
from skatemount.config.suite import SuiteConfig
from skatemount.envs.task import MountTask
from skatemount.evaluation.evaluator import deterministic, mix_seeds
from skatemount.evaluation.suite_task import EvaluationTask
from skatemount.exporting.folder import write_folder
from skatemount.models.actor_critic import ActorCritic
from skatemount.runs.checkpoint import save_policy

WORLDS = 4


def _stand(config: TrainConfig) -> None:
    config.start = copy.deepcopy(config.start)
    config.start.x, config.start.y, config.start.yaw = [0.0, 0.02], [0.0, 0.02], [-0.1, 0.1]
    config.randomization.kp = [0.9, 1.1]


def _pushed(config: TrainConfig) -> None:
    config.start.board_fixed, config.start.board_speed, config.start.drive = 0.0, [0.2, 0.5], True
    config.randomization.push_interval, config.randomization.push_velocity = [0.1, 0.3], [-0.5, 0.5]
    config.randomization.trunk_mass = [-0.5, 0.5]


def _sensed(config: TrainConfig) -> None:
    config.sensing = replace(
        config.sensing, target_delay=[0.0, 0.06], latency=[0, 2], board_age=[1, 3], board_seen=0.7, board_pos_bias=0.06,
        board_rot_bias=6.0, board_pos_jitter=0.01, board_rot_jitter=1.0, encoder_offset=0.03, joint_vel_noise=1.5,
        gyro_noise=0.2, gravity_noise=0.05, term_noise=False,
    )  # fmt: skip
    config.start.board_fixed = 0.0


def _walk(config: TrainConfig) -> None:
    config.command.mode, config.command.resample, config.success = "sampled", 0.3, "gait"


def _long_board(config: TrainConfig) -> None:
    config.board.deck_length, config.board.wheelbase = 0.9, 0.6


SUITES: dict[str, dict[str, Callable[[TrainConfig], None]]] = {
    "stand": {"": _stand},
    "pushed": {"": _pushed},
    "sensed": {"": _sensed},
    "walk": {"": _walk},
    "boards": {"usual": lambda config: None, "long": _long_board},
}
"""Changes of the policy's own task by suite and variant: success, pushes and loads on the board, sensors and delays,
commands, boards."""


@functools.cache
def policy_config() -> TrainConfig:
    overrides = [
        "curriculum=none",
        "observation=history", "+observation.policy.board_age={}", "network.actor=[8]", "network.critic=[8]",
        "physics.threads=1", f"physics.num_worlds={WORLDS}", "episode_length=1.2",
    ]  # fmt: skip
    return compose("mount", overrides)


@functools.cache
def policy_file() -> Path:
    """A policy with a small network that has had no training."""
    config = policy_config()
    task = MountTask(config=config)
    mdp = task.make_mdp(torch.Generator())
    torch.manual_seed(0)
    networks = ActorCritic(config.network, mdp.observation.size, mdp.privileged.size, mdp.context.layout.num_joints)
    path = Path(tempfile.mkdtemp(prefix="exported-")) / "tiny.safetensors"
    save_policy(path, {MODULE: networks}, make_policy_card(config, task, frames=0))
    return path


@functools.cache
def agent() -> TrainedPolicy:
    return TrainedPolicy.load(str(policy_file()))


def suite_task(name: str) -> EvaluationTask:
    configs = {}
    for variant, change in SUITES[name].items():
        configs[variant] = copy.deepcopy(policy_config())
        change(configs[variant])
    suite = SuiteConfig(name=name, description=f"{name} of the tests", stage="mount", seed=len(name))
    return EvaluationTask(agent(), name, suite, configs, [], 0)


@functools.cache
def folder() -> Path:
    """The policy exported, with `WORLDS` start states of each of `SUITES`."""
    path = policy_file().parent / "folder"
    write_folder(path, agent(), [suite_task(name) for name in SUITES], WORLDS)
    return path


class _Recorder:
    """Replaces a module's `coarse_noise` and keeps what it draws."""

    def __init__(self, module: Any):
        self._module, self._draw = module, module.coarse_noise
        self.drawn: list[np.ndarray] = []

    def __enter__(self) -> _Recorder:
        self._module.coarse_noise = self
        return self

    def __call__(self, shape: Any, generator: torch.Generator) -> torch.Tensor:
        values = self._draw(shape, generator)
        self.drawn.append(values.numpy().copy())
        return values

    def __exit__(self, *error: object) -> None:
        self._module.coarse_noise = self._draw


@functools.cache
def recording(suite: str, variant: int = 0) -> dict[str, np.ndarray]:
    """The first episodes of a suite as the torch version runs them, `[T + 1, N, ...]` by name.

    Targets, actions and flags are of the step that led to a row, so the first row's mean nothing.
    """
    task = suite_task(suite)
    evaluator = task.evaluator(list(task.configs)[variant])
    env = evaluator.env
    env.listeners.clear()
    scale, pose = env.mdp._scale, env.mdp.context.default_pose
    clip = env.task.scene.robot.config.action_clip
    rows: list[dict[str, torch.Tensor]] = []

    def note(targets: torch.Tensor, state: Any) -> None:
        episode = env.episode
        flags = {name: state[name].squeeze(1) for name in ("terminated", "truncated", "success")}
        noted = {"targets": targets, "observation": episode.observation, "mounted": episode.mounted, **flags}
        rows.append({name: value.clone() for name, value in noted.items()})

    try:
        with deterministic(1), _Recorder(observation_table) as noise, _Recorder(sensing) as errors:
            env.set_seed(mix_seeds(evaluator.seed, 0))
            state = env.reset()
            actor = task.agent.policy.actor_in(env)
            none = {name: torch.zeros(WORLDS, 1, dtype=torch.bool) for name in ("terminated", "truncated", "success")}
            note(torch.zeros(WORLDS, len(pose)), none)
            for _ in range(env.mdp.context.episode_steps):
                action = actor(state)["action"].clone()
                state = env.step(TensorDict({"observation": state["observation"], "action": action}, [WORLDS]))["next"]
                note(pose + scale * action.clamp(-clip, clip), state)
    finally:
        evaluator.close()
    made = {name: np.stack([row[name].numpy() for row in rows]) for name in rows[0]}
    drawn = {"noise": noise.drawn, "errors": errors.drawn}
    return made | {name: np.stack(values) for name, values in drawn.items() if values}
