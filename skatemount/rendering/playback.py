"""One episode of one world, step by step, to be drawn."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import mujoco
import numpy as np

from skatemount.envs.config.board import SkateboardConfig
from skatemount.evaluation.evaluator import Evaluator
from skatemount.evaluation.records import EpisodeRecords
from skatemount.evaluation.report import in_words
from skatemount.evaluation.suite_task import EvaluationTask
from skatemount.rendering.renderer import Frame

_ROBOT_REACH = np.array([[0.3, 0.0, 0.06], [-0.3, 0.0, 0.06], [0.0, 0.15, 0.06], [0.0, -0.15, 0.06]])
"""Ends of the trunk in its frame, m."""


@dataclass
class Episode:
    """An episode to be drawn.

    Attributes:
        frames: The start and every control step after it.
        model: The scene with everything there is to see.
        subjects: ``[K, 3]`` where robot and board were, m.
        feet: The feet's geom ids.
        control_step: Seconds between two frames.
        record: What came of it, a batch of one.
        summary: What came of it, in words.
    """

    frames: list[Frame]
    model: mujoco.MjModel
    subjects: np.ndarray
    feet: list[int]
    control_step: float
    record: EpisodeRecords
    summary: str


def replay_episode(trial: EvaluationTask, number: int) -> Episode:
    """Play an episode of a trial once more, exactly as it was evaluated.

    Every world of its round is stepped again: what one world meets is drawn together with the others.

    Args:
        trial: The policy and its test.
        number: The episode's, from 0.

    Returns:
        The episode.
    """
    variant, turn = trial.variant_of(number)
    evaluator = trial.evaluator(variant)
    env = evaluator.env
    rounds, world = divmod(turn, env.num_worlds)
    control_step = env.mdp.context.control_step
    corners = _board_corners(env.task.scene.board.config)
    frames: list[Frame] = []
    subjects: list[np.ndarray] = []
    ended = False

    def watch(step: int) -> None:
        nonlocal ended
        if ended:
            return
        sim, episode = env.sim, env.episode
        _, data = env.physics.render_data(world)
        frames.append(
            Frame(
                time=step * control_step,
                on_deck=episode.on_deck[world].tolist(),
                touching=episode.touching[world].tolist(),
                mounted=bool(episode.mounted[world]),
                qpos=data.qpos.copy(),
                mocap_pos=data.mocap_pos.copy(),
            )
        )
        feet_at, trunk_at, trunk_turned, board_at, board_turned = (
            getattr(sim, name)[world].cpu().numpy()
            for name in ("foot_pos", "base_pos", "base_rot", "board_pos", "board_rot")
        )
        subjects.append(feet_at)
        subjects.append(trunk_at + _ROBOT_REACH @ trunk_turned.T)
        subjects.append(board_at + corners @ board_turned.T)
        ended = evaluator.has_ended(world)

    try:
        records = evaluator.round(trial.agent.policy, rounds, watch)
        record = trial.numbered(variant, records[world : world + 1])
        model, _ = env.physics.render_data(world)
        feet = [model.geom(geom.full_identifier).id for geom in env.task.scene.robot.foot_geoms]
        summary = _summary(evaluator, record, frames[-1])
    finally:
        evaluator.close()
    return Episode(frames, model, np.concatenate(subjects), feet, control_step, record, summary)


def _board_corners(board: SkateboardConfig) -> np.ndarray:
    """``[8, 3]`` corners of the box around the board, kicks and wheels included, board frame."""
    x, y = board.deck_length / 2 + board.kick_length, board.deck_width / 2
    return np.array(list(itertools.product((-x, x), (-y, y), (-board.deck_height, 0.0))))


def _summary(evaluator: Evaluator, record: EpisodeRecords, last: Frame) -> str:
    if record.success:
        time = float(record.mount_time)
        return "succeeded" + (f", mounted {time:.2f} s after the first foot touched the board" if time >= 0 else "")
    if record.end:
        return f"failed, ended after {last.time:.2f} s by {in_words(evaluator.ends[int(record.end)])}"
    return f"failed, {sum(last.on_deck)} feet on the board after {last.time:.2f} s"
