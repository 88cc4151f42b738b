"""An episode of an evaluation, played once more to be drawn."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import torch

from skatemount.envs import success
from skatemount.evaluation.evaluator import Evaluator
from skatemount.evaluation.records import EpisodeRecords
from skatemount.evaluation.results import in_words
from skatemount.evaluation.suite_task import EvaluationTask
from skatemount.rendering.overlay import Frame

SEARCHED = 256
"""Episodes, from number 0 on, among which the first success is looked for."""

NEAR_GROUND = 0.005
"""Height of a foot above the ground, m, up to which a label calls it on the ground: a foot that bounces or is just
lifted has no contact force, and it is not in the air for a viewer."""


@dataclass
class Episode:
    """An episode to be drawn.

    Attributes:
        number: Its number in the evaluation.
        frames: The start and every control step after it.
        model: The scene with everything that is visible.
        feet: The feet's geom ids.
        robot: ``[T, K, 3]`` points around the robot in each frame, m.
        board: ``[T, L, 3]`` points around the board, m.
        heading: Direction of the board at the start, degrees.
        control_step: Seconds between two frames.
        record: Its result, a batch of one.
        summary: Its result in words.
        choice: The reason why it was chosen, in words; empty if the user named it.
    """

    number: int
    frames: list[Frame]
    model: mujoco.MjModel
    feet: list[int]
    robot: np.ndarray
    board: np.ndarray
    heading: float
    control_step: float
    record: EpisodeRecords
    summary: str
    choice: str = ""


class _Tape:
    """Keeps the poses and contacts of some worlds at every step of a round.

    Args:
        evaluator: Runs the round.
        worlds: The worlds to keep.
    """

    def __init__(self, evaluator: Evaluator, worlds: slice):
        self._env, self._worlds = evaluator.env, worlds
        self._poses: list[tuple[np.ndarray, np.ndarray]] = []
        self._contacts: list[np.ndarray] = []

    def note(self, step: int) -> None:
        """Keep the present state; called at the start and after every control step."""
        env, worlds = self._env, self._worlds
        sim, episode = env.sim, env.episode
        self._poses.append(env.physics.poses(worlds))
        off_deck = success.feet_off_deck_contact(sim)
        # Success forgives a foot that leaves the deck for a moment, and so does the label.
        on_deck = (episode.off_time <= success.FLICKER + 1e-3) & ~off_deck
        height = sim.foot_pos[..., 2] - sim.ground_height.unsqueeze(1) - env.mdp.context.foot_radius
        touching = on_deck | off_deck | (height <= NEAR_GROUND)
        task = env.mdp.definition
        state = torch.zeros_like(episode.mounted)
        if task.in_state is not None:
            state = task.in_state(sim, episode, env.mdp.context)
        self._contacts.append(torch.cat((on_deck, touching, state.unsqueeze(1)), 1)[worlds].cpu().numpy())

    def frames(self, row: int, duration: float) -> list[Frame]:
        """Return the frames of an episode.

        Args:
            row: Of the worlds that were kept.
            duration: Of the episode, s.
        """
        context = self._env.mdp.context
        step, legs = context.control_step, context.layout.legs
        feet, word = len(legs), self._env.mdp.definition.state_word
        return [
            Frame(
                time=i * step,
                legs=legs,
                on_deck=contacts[row, :feet].tolist(),
                touching=contacts[row, feet : 2 * feet].tolist(),
                state=word if contacts[row, 2 * feet] else "",
                qpos=qpos[row],
                mocap_pos=mocap_pos[row],
            )
            for i, ((qpos, mocap_pos), contacts) in enumerate(zip(self._poses, self._contacts, strict=True))
            if i <= round(duration / step)
        ]


def replay_episode(trial: EvaluationTask, number: int | None = None) -> Episode:
    """Play an episode of a trial once more, exactly as it was evaluated.

    Every world of its round is stepped again, because the random draws of one world depend on the others.

    Args:
        trial: The policy and its test.
        number: The episode's, from 0; none for the first success among the first `SEARCHED` episodes of the first
            round, or episode 0 if there is none.

    Returns:
        The episode.
    """
    if number is not None:
        variant, turn = trial.variant_of(number)
        return _play(trial, variant, turn)
    return _first_success(trial)


def _play(trial: EvaluationTask, variant: str, turn: int) -> Episode:
    """Play an episode, given by its number among those of its variant."""
    evaluator = trial.evaluator(variant)
    try:
        rounds, world = divmod(turn, evaluator.env.num_worlds)
        tape = _Tape(evaluator, slice(world, world + 1))
        records = evaluator.round(trial.agent.policy, rounds, tape.note)
        record = trial.numbered(variant, records[world : world + 1])
        return _episode(evaluator, world, record, tape.frames(0, float(record.duration)))
    finally:
        evaluator.close()


def _first_success(trial: EvaluationTask) -> Episode:
    """Play the first round of each variant and return the first success, or episode 0."""
    found: Episode | None = None
    first: Episode | None = None
    played: list[EpisodeRecords] = []
    ends: list[str] = []  # in words
    for i, variant in enumerate(trial.configs):
        # Variants take turns: the lowest number of variant i is i.
        if found is not None and found.number < i or i >= SEARCHED:
            break
        evaluator = trial.evaluator(variant)
        try:
            count = min(evaluator.env.num_worlds, math.ceil((SEARCHED - i) / len(trial.configs)))
            tape = _Tape(evaluator, slice(0, count))
            records = trial.numbered(variant, evaluator.round(trial.agent.policy, 0, tape.note)[:count])
            played.append(records)
            ends = [in_words(end, evaluator.env.mdp.definition) for end in evaluator.end_names]
            rows = records.success.nonzero().flatten().tolist()
            for row in rows[:1]:
                if found is None or int(records.number[row]) < found.number:
                    found = _episode(
                        evaluator, row, records[row : row + 1], tape.frames(row, float(records.duration[row]))
                    )
            if i == 0 and found is None:
                first = _episode(evaluator, 0, records[:1], tape.frames(0, float(records.duration[0])))
        finally:
            evaluator.close()
    records = EpisodeRecords.cat(played)
    records = records[records.number.argsort()]
    if found is None:
        assert first is not None
        first.choice = f"none of the first {len(records)} episodes succeeded"
        return first
    found.choice = "the first success" + _failures_before(records, found.number, ends)
    return found


def _failures_before(records: EpisodeRecords, number: int, ends: Sequence[str]) -> str:
    """Return the failures with lower numbers in words, each cause with its count; nothing if there are none."""
    if not number:
        return ""
    causes: dict[str, int] = {}
    for end in records.end[records.number < number].tolist():
        cause = ends[end]
        causes[cause] = causes.get(cause, 0) + 1
    which = "episode 0" if number == 1 else f"episodes 0 to {number - 1}"
    said = ", ".join(cause if number == 1 else f"{cause} {count}" for cause, count in causes.items())
    return f"; {which} failed: {said}"


def _episode(evaluator: Evaluator, world: int, record: EpisodeRecords, frames: list[Frame]) -> Episode:
    env = evaluator.env
    scene = env.task.scene
    model, _ = env.physics.render_data(world)
    robot, board = (
        int(model.body_rootid[model.body(frame.full_identifier).id]) for frame in (scene.robot_frame, scene.board_frame)
    )
    points = visible_points(model, frames, (robot, board))
    summary = _summary(evaluator, record, frames[-1])
    succeeded = bool(record.success)
    frames[-1].succeeded = succeeded
    frames[-1].outcome = "success" if succeeded else f"failed: {_end(evaluator, record)}"
    return Episode(
        number=int(record.number),
        frames=frames,
        model=model,
        feet=[model.geom(geom.full_identifier).id for geom in scene.robot.foot_geoms],
        robot=points[0],
        board=points[1],
        heading=_heading(model, frames[0], board),
        control_step=env.mdp.context.control_step,
        record=record,
        summary=summary,
    )


def visible_points(model: mujoco.MjModel, frames: Sequence[Frame], roots: Sequence[int]) -> list[np.ndarray]:
    """Return ``[T, K, 3]`` corners of the boxes around the visible geoms of each tree of bodies, m."""
    data = mujoco.MjData(model)
    corners = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij"), -1).reshape(1, 8, 3)
    local = model.geom_aabb[:, None, :3] + corners * model.geom_aabb[:, None, 3:]
    shown = model.geom_rgba[:, 3] > 0
    chosen = [np.flatnonzero(shown & (model.body_rootid[model.geom_bodyid] == root)) for root in roots]
    points: list[list[np.ndarray]] = [[] for _ in roots]
    for frame in frames:
        data.qpos[:], data.mocap_pos[:] = frame.qpos, frame.mocap_pos
        mujoco.mj_kinematics(model, data)
        for geoms, found in zip(chosen, points, strict=True):
            turned = local[geoms] @ data.geom_xmat[geoms].reshape(-1, 3, 3).transpose(0, 2, 1)
            found.append((data.geom_xpos[geoms, None] + turned).reshape(-1, 3))
    return [np.stack(each) for each in points]


def _heading(model: mujoco.MjModel, frame: Frame, body: int) -> float:
    """Return the direction of a body's x axis about the vertical, degrees."""
    data = mujoco.MjData(model)
    data.qpos[:], data.mocap_pos[:] = frame.qpos, frame.mocap_pos
    mujoco.mj_kinematics(model, data)
    return math.degrees(math.atan2(data.xmat[body][3], data.xmat[body][0]))


def _end(evaluator: Evaluator, record: EpisodeRecords) -> str:
    """Return the end of a failed episode in words."""
    return in_words(evaluator.end_names[int(record.end)], evaluator.env.mdp.definition)


def _summary(evaluator: Evaluator, record: EpisodeRecords, last: Frame) -> str:
    """Return the result of an episode in words, with the task's main metrics if it lasted until the time limit."""
    if record.end:
        return f"failed, ended after {last.time:.2f} s by {_end(evaluator, record)}"
    mdp = evaluator.env.mdp
    most = mdp.definition.most(mdp.context.layout)
    metrics = mdp.definition.metrics_of(mdp.definition.overview)
    values = {metric: float(record.metrics[metric.name]) for metric in metrics}
    said = [f"{m.label} {m.short(value, most.get(m.name))}" for m, value in values.items() if math.isfinite(value)]
    return ", ".join(["succeeded" if record.success else f"failed, {_end(evaluator, record)}", *said])
