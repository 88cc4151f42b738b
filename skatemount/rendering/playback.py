"""An episode of an evaluation, played once more to be drawn."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import mujoco
import numpy as np
import torch
from torch import Tensor

from skatemount.agents.policy import Policy
from skatemount.envs import success
from skatemount.envs.physics.base import Physics
from skatemount.evaluation.evaluator import Evaluator
from skatemount.evaluation.records import EpisodeRecords
from skatemount.evaluation.results import in_words
from skatemount.evaluation.suite_task import EvaluationTask
from skatemount.rendering.overlay import Frame

NEAR_GROUND = 0.005
"""Height of a foot above the ground, m, up to which a label calls it on the ground: a foot that bounces or is just
lifted has no contact force, and it is not in the air for a viewer."""
PUSH_TIME = 0.4
"""Time for which a label tells of a push, s."""


@dataclass
class Episode:
    """An episode to be drawn.

    Attributes:
        number: Its number in the evaluation.
        variant: Name of the suite's variant, with the unit of a ladder's step; empty if it has none.
        frames: The start and every control step after it, each in ``parts`` frames.
        parts: Frames of a control step.
        model: The scene with everything that is visible.
        feet: The feet's geom ids.
        robot: ``[T, K, 3]`` points around the robot after each control step, m.
        board: ``[T, L, 3]`` points around the board, m.
        deck: Length and width of the deck in words if boards vary from episode to episode, else empty.
        heading: Direction of the board at the start, degrees.
        control_step: Seconds of a control step.
        record: Its result, a batch of one.
        summary: Its result in words.
        choice: The reason why it was chosen, in words; empty if the user named it.
    """

    number: int
    variant: str
    frames: list[Frame]
    parts: int
    model: mujoco.MjModel
    feet: list[int]
    robot: np.ndarray
    board: np.ndarray
    deck: str
    heading: float
    control_step: float
    record: EpisodeRecords
    summary: str
    choice: str = ""

    @property
    def time_step(self) -> float:
        """Seconds between two frames."""
        return self.control_step / self.parts


def replay_episodes(trial: EvaluationTask, numbers: Sequence[int], parts: int = 1) -> list[Episode]:
    """Play episodes of a trial once more, exactly as they were evaluated.

    Every world of their rounds is stepped again, because the random draws of one world depend on the others.

    Args:
        trial: The policy and its test.
        numbers: Their numbers, from 0.
        parts: Frames of a control step; more of them make a smooth slow motion. Each is a state of the simulation.

    Returns:
        The episodes, in the order of their numbers in ``numbers``.
    """
    found: dict[int, Episode] = {}
    turns: dict[str, list[int]] = {}
    for number in numbers:
        variant, turn = trial.variant_of(number)
        turns.setdefault(variant, []).append(turn)
    for variant, wanted in turns.items():
        with contextlib.closing(trial.evaluator(variant)) as evaluator:
            size = evaluator.env.num_worlds
            for turn in sorted({each // size for each in wanted}):
                worlds = sorted({each % size for each in wanted if each // size == turn})
                tape = Tape(evaluator, worlds, parts)
                records = trial.numbered(variant, tape.play(trial.agent.policy, turn))
                for world in worlds:
                    episode = make_episode(evaluator, words_of(trial, variant), tape, world, records[world : world + 1])
                    found[episode.number] = episode
    return [found[number] for number in numbers]


def words_of(trial: EvaluationTask, variant: str) -> str:
    """Return the name of a variant, with the unit if it is the step of a ladder whose names lack it."""
    unit = "" if trial.suite is None or not trial.suite.ladder else trial.suite.unit
    return variant if not unit or variant.endswith(unit) else f"{variant} {unit}"


class Tape:
    """Keeps the poses and contacts of some worlds throughout a round.

    Args:
        evaluator: Runs the round.
        worlds: Indices of the worlds to keep, in order.
        parts: Poses to keep of each control step; a divisor of the physics steps in it.
    """

    def __init__(self, evaluator: Evaluator, worlds: Sequence[int], parts: int = 1):
        self.parts = parts
        self._evaluator, self._env = evaluator, evaluator.env
        self._range = slice(worlds[0], worlds[-1] + 1)
        self._row = {world: i for i, world in enumerate(worlds)}
        self._worlds = np.array(worlds)
        self._poses: list[tuple[np.ndarray, np.ndarray]] = []
        self._contacts: list[np.ndarray] = []
        self._pushes: list[np.ndarray] = []

    def __len__(self) -> int:
        """Return the number of worlds that are kept."""
        return len(self._worlds)

    def play(self, policy: Policy, number: int) -> EpisodeRecords:
        """Run a round of the evaluator, and return its records."""
        env, physics = self._env, self._env.physics
        env.physics = cast("Physics", _Watched(physics, self))
        try:
            return self._evaluator.round(policy, number, self._note)
        finally:
            env.physics = physics

    def frames(self, world: int, duration: float) -> list[Frame]:
        """Return the frames of an episode.

        Args:
            world: One of the worlds that were kept.
            duration: Of the episode, s.
        """
        context, row = self._env.mdp.context, self._row[world]
        step, legs = context.control_step, context.layout.legs
        feet, word = len(legs), self._env.mdp.definition.state_word
        frames = []
        for i in range(round(duration / step) * self.parts + 1):
            # The contacts between two control steps are not measured: those of the coming one stand for them.
            contacts = self._contacts[-(-i // self.parts)][row]
            qpos, mocap_pos = self._poses[i]
            frame = Frame(
                time=i * step / self.parts,
                legs=legs,
                on_deck=contacts[:feet].tolist(),
                touching=contacts[feet : 2 * feet].tolist(),
                state=word if contacts[2 * feet] else "",
                qpos=qpos[row],
                mocap_pos=mocap_pos[row],
                push=self._push_before(i, row),
            )
            frames.append(frame)
        return frames

    def _push_before(self, i: int, row: int) -> float:
        """Return the speed of the last push before a frame, m/s; 0 if it was longer ago than `PUSH_TIME`."""
        step, known = -(-i // self.parts), round(PUSH_TIME / self._env.mdp.context.control_step)
        speeds = [each[row] for each in self._pushes[max(0, step - known) : step] if each[row]]
        return float(speeds[-1]) if speeds else 0.0

    def keep_pose(self) -> None:
        """Keep the present poses."""
        qpos, mocap_pos = self._env.physics.poses(self._range)
        rows = self._worlds - self._range.start
        self._poses.append((qpos[rows], mocap_pos[rows]))

    def keep_push(self, mask: Tensor, velocity: Tensor) -> None:
        """Keep the speed of the pushes of the coming control step, m/s."""
        speed = torch.linalg.vector_norm(velocity.cpu(), dim=-1).numpy()
        self._pushes[-1] += np.where(mask.cpu().numpy(), speed, 0.0)[self._worlds]

    def _note(self, step: int) -> None:
        """Keep the present state; called at the start and after every control step."""
        env = self._env
        sim, episode = env.sim, env.episode
        self.keep_pose()
        self._pushes.append(np.zeros(len(self._worlds)))
        off_deck = success.feet_off_deck_contact(sim)
        # Success forgives a foot that leaves the deck for a moment, and so does the label.
        on_deck = (episode.off_time <= success.FLICKER + 1e-3) & ~off_deck
        height = sim.foot_pos[..., 2] - sim.ground_height.unsqueeze(1) - env.mdp.context.foot_radius
        touching = on_deck | off_deck | (height <= NEAR_GROUND)
        task = env.mdp.definition
        state = torch.zeros_like(episode.mounted)
        if task.in_state is not None:
            state = task.in_state(sim, episode, env.mdp.context)
        self._contacts.append(torch.cat((on_deck, touching, state.unsqueeze(1)), 1)[self._worlds].cpu().numpy())


class _Watched:
    """An engine that tells a tape of its pushes, and of the poses within its control steps.

    The physics steps are the same, whether an engine is asked for them at once or in parts.

    Args:
        physics: The engine.
        tape: The tape.
    """

    def __init__(self, physics: Physics, tape: Tape):
        self._physics, self._tape = physics, tape

    def __getattr__(self, name: str) -> Any:
        return getattr(self._physics, name)

    def step(self, targets: Tensor, substeps: int) -> None:
        """Advance every world; see `Physics.step`."""
        parts = self._tape.parts
        for part in range(parts):
            if part:
                self._tape.keep_pose()
            self._physics.step(targets, substeps // parts)

    def push(self, mask: Tensor, velocity: Tensor, board: bool = False) -> None:
        """Push the robots or the boards; see `Physics.push`."""
        self._tape.keep_push(mask, velocity)
        self._physics.push(mask, velocity, board)


def make_episode(evaluator: Evaluator, variant: str, tape: Tape, world: int, record: EpisodeRecords) -> Episode:
    """Return an episode that a tape has kept.

    Args:
        evaluator: Ran the round.
        variant: Name of the variant in words.
        tape: The tape.
        world: The episode's world.
        record: Its result, a batch of one.
    """
    env = evaluator.env
    scene = env.task.scene
    frames = tape.frames(world, float(record.duration))
    model, _ = env.physics.render_data(world)
    robot, board = (
        int(model.body_rootid[model.body(frame.full_identifier).id]) for frame in (scene.robot_frame, scene.board_frame)
    )
    points = visible_points(model, frames[:: tape.parts], (robot, board))
    summary = _summary(evaluator, record, frames[-1])
    succeeded = bool(record.success)
    frames[-1].succeeded = succeeded
    frames[-1].outcome = "success" if succeeded else f"failed: {_end(evaluator, record)}"
    deck = ""
    if env.boards is not None:
        size = env.boards.of_world[world]
        deck = f"deck {100 * size.deck_length:.0f} x {100 * size.deck_width:.0f} cm"
    return Episode(
        number=int(record.number),
        variant=variant,
        frames=frames,
        parts=tape.parts,
        model=model,
        feet=[model.geom(geom.full_identifier).id for geom in scene.robot.foot_geoms],
        robot=points[0],
        board=points[1],
        deck=deck,
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
    known = {m: m.short(value, most.get(m.name)) for m, value in values.items() if math.isfinite(value)}
    said = [m.of_one.format(value) if m.of_one else f"{m.label} {value}" for m, value in known.items()]
    return ", ".join(["succeeded" if record.success else f"failed, {_end(evaluator, record)}", *said])
