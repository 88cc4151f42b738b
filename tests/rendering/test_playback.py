"""Episodes played once more, and the labels and points that a film is made of."""

from __future__ import annotations

import re

import numpy as np
import pytest
from filmed import filmed

from skatemount.rendering import playback
from skatemount.rendering.camera import LABEL_ROOM, MARGIN, VIEWS, camera_path
from skatemount.rendering.playback import Episode, replay_episodes, words_of
from skatemount.rendering.search import first_success


@pytest.fixture(scope="module")
def mounting() -> Episode:
    """A shipped policy that walks up to a free board and steps on."""
    return first_success(filmed("approach-unfixed"))


def test_a_mounting_is_filmed(mounting: Episode) -> None:
    assert bool(mounting.record.success)
    assert mounting.choice.startswith("the first success")
    assert re.match(r"succeeded, mounted \d\.\d\d s after the first contact, feet", mounting.summary)
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


def test_an_episode_is_drawn_with_its_own_board() -> None:
    trial = filmed("outside-boards", "episode_length=0.4", worlds=5)
    (config,) = trial.configs.values()
    numbers = (13, 7)
    for number, episode in zip(numbers, replay_episodes(trial, numbers), strict=True):
        changes = config.boards.fixed[number]
        length, width = changes["deck_length"], changes["deck_width"]
        assert episode.model.geom("board/deck").size[:2].tolist() == pytest.approx([length / 2, width / 2])
        assert episode.deck == f"deck {100 * length:.0f} x {100 * width:.0f} cm"


def test_a_slow_motion_shows_more_states_of_the_same_episode() -> None:
    """Between the control steps lie states of the simulation, which itself stays the same bit for bit."""
    trial = filmed("delay", "episode_length=0.8")
    numbers = (9, 2, 0)
    for usual, slow in zip(replay_episodes(trial, numbers), replay_episodes(trial, numbers, parts=4), strict=True):
        assert len(slow.frames) == 4 * len(usual.frames) - 3
        assert [usual.number, usual.variant, usual.summary] == [slow.number, slow.variant, slow.summary]
        for i, frame in enumerate(usual.frames):
            same = slow.frames[4 * i]
            np.testing.assert_array_equal(same.qpos, frame.qpos)
            assert (same.time, same.on_deck, same.state) == (pytest.approx(frame.time), frame.on_deck, frame.state)
        assert slow.time_step == pytest.approx(0.01)
        times = np.array([frame.time for frame in slow.frames])
        np.testing.assert_allclose(np.diff(times), 0.01)
        moved = np.array([np.abs(b.qpos - a.qpos).max() for a, b in zip(slow.frames, slow.frames[1:], strict=False)])
        assert (moved > 0).all() and moved.max() < 1.0
        assert slow.frames[-1].outcome and not any(frame.outcome for frame in slow.frames[:-1])
        assert len(slow.robot) == len(usual.robot) == len(usual.frames)
    assert [trial.variant_of(number)[0] for number in numbers] == ["20ms", "40ms", "0ms"]


def test_pushes_are_noted() -> None:
    changes = ["randomization.push_interval=[0.6,0.6]", "randomization.push_velocity=[0.3,0.3]", "episode_length=1.2"]
    (episode,) = replay_episodes(filmed("approach-unfixed", *changes), [1], parts=2)
    told = np.array([frame.push for frame in episode.frames])
    jumps = np.flatnonzero(np.diff(told))
    # A push comes before the first physics step of a control step, and its label stays for a moment.
    assert told[told > 0] == pytest.approx(0.3 * 2**0.5)
    first, over = jumps[:2].tolist()
    assert told[first + 1] > 0 == told[over + 1] and first % 2 == 0
    assert over - first == 2 * round(playback.PUSH_TIME / episode.control_step)


def test_the_step_of_a_ladder_has_its_unit() -> None:
    assert [words_of(filmed("pushed"), name) for name in ("0.25", "0.75")] == ["0.25 m/s", "0.75 m/s"]
    assert words_of(filmed("delay"), "20ms") == "20ms"
    assert words_of(filmed("approach-unfixed"), "") == ""
    assert words_of(filmed("other-boards"), "penny") == "penny"
