"""One episode of one world, step by step, to be drawn."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import mujoco
import numpy as np

from skatemount.benchmark.evaluation import deterministic, first_end
from skatemount.config import Config
from skatemount.envs import success
from skatemount.envs.entities.skateboard import SkateboardConfig
from skatemount.envs.mount_env import MountEnv
from skatemount.envs.task import MountTask
from skatemount.models import ActorCritic
from skatemount.rendering import Moment

_ROBOT_REACH = np.array([[0.3, 0.0, 0.06], [-0.3, 0.0, 0.06], [0.0, 0.15, 0.06], [0.0, -0.15, 0.06]])
"""Ends of the trunk in its frame, m."""


@dataclass
class Episode:
    """An episode to be drawn.

    Attributes:
        moments: The start and every control step after it.
        model: The scene with everything there is to see.
        subjects: ``[K, 3]`` where robot and board were, m.
        feet: The feet's geom ids.
        control_step: Seconds between two moments.
        succeeded: What the environment says.
        verdict: What came of it, in words.
    """

    moments: list[Moment]
    model: mujoco.MjModel
    subjects: np.ndarray
    feet: list[int]
    control_step: float
    succeeded: bool
    verdict: str


def play(networks: ActorCritic, config: Config, seed: int) -> Episode:
    """Play the first episode that a seed gives, with deterministic actions.

    Args:
        networks: The policy.
        config: The task.
        seed: Source of the world, the start state and the noise.

    Returns:
        The episode.
    """
    env = MountEnv(MountTask(config=config), num_worlds=1, threads=1, seed=seed)
    step = env.mdp.context.control_step
    corners = _board_corners(env.task.scene.board.config)
    moments, subjects = [], []
    seen, done = env.reset(), False
    with deterministic():
        while True:
            sim, episode = env.sim, env.episode
            model, data = env.physics.world(0)
            moments.append(
                Moment(
                    time=int(episode.step[0]) * step,
                    on_deck=episode.on_deck[0].tolist(),
                    touching=episode.touching[0].tolist(),
                    mounted=bool(episode.mounted[0]),
                    qpos=data.qpos.copy(),
                    mocap_pos=data.mocap_pos.copy(),
                )
            )
            subjects.append(sim.foot_pos[0].numpy())
            subjects.append(sim.base_pos[0].numpy() + _ROBOT_REACH @ sim.base_rot[0].numpy().T)
            subjects.append(sim.board_pos[0].numpy() + corners @ sim.board_rot[0].numpy().T)
            if done:
                break
            seen = env.step(networks.actor(seen))["next"]
            done = bool(seen["done"])
    succeeded = bool(seen["success"])
    verdict = _verdict(env, succeeded)
    feet = [model.geom(geom.full_identifier).id for geom in env.task.scene.robot.foot_geoms]
    env.close()
    return Episode(moments, model, np.concatenate(subjects), feet, step, succeeded, verdict)


def _board_corners(board: SkateboardConfig) -> np.ndarray:
    """``[8, 3]`` corners of the box around the board, kicks and wheels included, board frame."""
    x, y = board.deck_length / 2 + board.kick_length, board.deck_width / 2
    return np.array(list(itertools.product((-x, x), (-y, y), (-board.deck_height, 0.0))))


def _verdict(env: MountEnv, succeeded: bool) -> str:
    end = int(first_end(env)[0])
    step = env.mdp.context.control_step
    elapsed = float(env.episode.step[0]) * step
    if end:
        return f"failed, ended after {elapsed:.2f} s by {env.mdp.end_names()[end - 1].replace('_', ' ')}"
    if not succeeded:
        return f"failed, {int(env.episode.on_deck.sum())} feet on the board after {elapsed:.2f} s"
    if env.task.config.success != "mount":
        return "succeeded"
    time = float(success.time_to_mount(env.episode, step)[0])
    return f"succeeded, mounted {time:.2f} s after the first foot touched the board"
