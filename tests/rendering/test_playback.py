"""Episodes played once more: the choice of one, and the labels and points that a film is made of."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from skatemount.config import compose_program
from skatemount.config.suite import SuiteConfig
from skatemount.evaluation.records import EpisodeRecords
from skatemount.evaluation.suite_task import EvaluationTask
from skatemount.rendering import playback
from skatemount.rendering.camera import LABEL_ROOM, MARGIN, VIEWS, camera_path
from skatemount.rendering.playback import Episode, replay_episode


def task(suite: str, *overrides: str, policy: str = "best", worlds: int = 6) -> EvaluationTask:
    settings = [f"checkpoint=pretrained:{policy}", f"suite={suite}", f"physics.num_worlds={worlds}"]
    settings += ["physics.threads=1", *overrides]
    (found,) = EvaluationTask.prepare(compose_program("record", settings), settings)
    return found


@pytest.fixture(scope="module")
def mounting() -> Episode:
    """A shipped policy that walks up to a free board and steps on."""
    return replay_episode(task("approach-unfixed"))


def test_a_mounting_is_filmed(mounting: Episode) -> None:
    assert bool(mounting.record.success)
    assert mounting.choice.startswith("the first success")
    assert mounting.summary.startswith("succeeded, time to mount ")
    last = mounting.frames[-1]
    assert (last.outcome, last.succeeded, last.word) == ("success", True, "mounted")
    assert not any(frame.outcome for frame in mounting.frames[:-1])


def test_mounted_means_four_feet(mounting: Episode) -> None:
    words = {frame.word for frame in mounting.frames}
    assert words == {"start", "", "mounted"}
    for frame in mounting.frames:
        assert not frame.state or all(frame.on_deck)
        assert all(touch for deck, touch in zip(frame.on_deck, frame.touching, strict=True) if deck)


def test_feet_near_the_ground_are_not_in_the_air(mounting: Episode) -> None:
    import mujoco

    data = mujoco.MjData(mounting.model)
    grounded = 0
    for frame in mounting.frames[1:]:
        data.qpos[:], data.mocap_pos[:] = frame.qpos, frame.mocap_pos
        mujoco.mj_kinematics(mounting.model, data)
        bottom = data.geom_xpos[mounting.feet, 2] - mounting.model.geom_size[mounting.feet, 0]
        low = bottom < playback.NEAR_GROUND - 1e-4
        assert (np.array(frame.touching) | ~low).all()
        grounded += int(low.sum())
    assert grounded > 10
    assert mounting.frames[0].word == "start"


@pytest.mark.parametrize("view", VIEWS)
def test_the_camera_keeps_robot_and_board_in_the_picture_and_is_close(mounting: Episode, view: str) -> None:
    aspect = 4 / 3
    step = mounting.control_step
    path = camera_path(VIEWS[view], mounting.robot, mounting.board, mounting.heading, aspect, step)
    robot, board = path.project(mounting.robot, aspect), path.project(mounting.board, aspect)
    for seen in (robot, board):
        assert np.abs(seen[..., 0]).max() <= MARGIN + 1e-9
        assert LABEL_ROOM - MARGIN - 1e-9 <= seen[..., 1].min() <= seen[..., 1].max() <= MARGIN + 1e-9
    share = ((robot.max(1) - robot.min(1)) / 2).max(1)
    assert share.min() > (0.35 if view == "follow" else 0.25)
    if view != "fixed":
        assert share[-20:].min() > 0.55
    acceleration = np.diff(path.position, 2, axis=0) / step**2
    assert np.linalg.norm(acceleration, axis=1).max() < 5
    assert path.position[:, 2].min() > 0.2


def test_points_surround_robot_and_board(mounting: Episode) -> None:
    assert len(mounting.robot) == len(mounting.board) == len(mounting.frames)
    size = np.ptp(mounting.board[0], axis=0)
    assert size[0] == pytest.approx(0.575 + 2 * 0.07, abs=0.08)
    assert size[2] < 0.2
    assert 0.3 < np.ptp(mounting.robot[-1], axis=0)[2] < 0.6
    assert np.ptp(mounting.robot[-1], axis=0).max() > 0.5


def failing(*overrides: str, **kwargs: int) -> EvaluationTask:
    """Some of these are thrown over, and those that are not stand."""
    return task("balance-fixed", "start.ang_vel=[-6,6]", "episode_length=1.6", *overrides, policy="balance", **kwargs)


def first_of(records: EpisodeRecords) -> int:
    return int(records.number[records.success][0])


def test_the_first_success_is_chosen_and_the_failures_before_are_told() -> None:
    trial = failing("seed=6")
    records = trial.evaluate(6).records
    number = first_of(records)
    episode = replay_episode(trial)
    assert episode.number == number > 0
    assert "the first success; episode" in episode.choice and " failed: " in episode.choice
    evaluated, again = (vars(each) | each.metrics for each in (records[number : number + 1], episode.record))
    for name in evaluated.keys() - {"metrics"}:
        value, played = evaluated[name], again[name]
        assert torch.equal(played, value) or bool((played != played).all() and (value != value).all()), name
    named = replay_episode(trial, number)
    assert named.choice == ""
    np.testing.assert_array_equal(named.frames[-1].qpos, episode.frames[-1].qpos)


def test_without_a_success_the_first_episode_is_filmed_with_its_end() -> None:
    episode = replay_episode(failing("termination.tilt.params.degrees=1"))
    assert episode.number == 0
    assert episode.choice == "none of the first 6 episodes succeeded"
    assert episode.frames[-1].outcome == "failed: robot fell"
    assert not episode.frames[-1].succeeded


def test_variants_take_turns() -> None:
    """The lowest number counts, whichever variant it belongs to; the first variant never succeeds here."""
    base = failing()
    variants = {"never": ["termination.tilt.params.degrees=1"], "often": ["start.ang_vel=[0,0]"]}
    suite = SuiteConfig(name="test", stage="balance", overrides=["episode_length=1.6"], variants=variants)
    trial = EvaluationTask.of(base.agent, suite, ["physics.num_worlds=3", "physics.threads=1"])
    records = trial.evaluate(6).records
    episode = replay_episode(trial)
    assert episode.number == first_of(records)
    assert episode.number % 2 == 1


def test_no_more_than_the_first_episodes_are_searched(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(playback, "SEARCHED", 2)
    episode = replay_episode(failing("termination.tilt.params.degrees=1"))
    assert episode.choice == "none of the first 2 episodes succeeded"


def test_an_episode_is_drawn_with_its_own_board() -> None:
    trial = task("outside-boards", "episode_length=0.4", worlds=5)
    (config,) = trial.configs.values()
    for number in (7, 13):
        changes = config.boards.fixed[number]
        model = replay_episode(trial, number).model
        deck = model.geom("board/deck").size
        assert deck[:2].tolist() == pytest.approx([changes["deck_length"] / 2, changes["deck_width"] / 2])
