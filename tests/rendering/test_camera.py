"""Camera paths; what needs no OpenGL."""

from __future__ import annotations

import numpy as np
import pytest

from skatemount.rendering.camera import LABEL_ROOM, MARGIN, REACH, VIEWS, camera_path

STEP, ASPECT = 0.04, 4 / 3
BOARD = np.array([[x, y, z] for x in (-0.36, 0.36) for y in (-0.13, 0.13) for z in (0.0, 0.09)])
ROBOT = np.array([[x, y, z] for x in (-0.3, 0.3) for y in (-0.15, 0.15) for z in (-0.3, 0.06)])


def walk(start: tuple[float, float], steps: int = 200, jitter: float = 0.02) -> tuple[np.ndarray, np.ndarray]:
    """Return robot and board points of an episode: it walks up to the board at 0.6 m/s, steps on and stands."""
    seconds = max(np.hypot(*start), 0.1) / 0.6
    share = np.clip(np.arange(steps) * STEP / seconds, 0, 1)[:, None, None]
    place = (1 - share) * np.array([*start, 0.3]) + share * np.array([0.0, 0.0, 0.39])
    shaken = jitter * np.random.default_rng(0).normal(size=place.shape)
    return ROBOT + place + shaken, np.broadcast_to(BOARD, (steps, *BOARD.shape))


def inside(projected: np.ndarray) -> bool:
    low, high = projected.min((0, 1)), projected.max((0, 1))
    return bool((np.abs([low[0], high[0]]) <= MARGIN + 1e-9).all() and low[1] >= LABEL_ROOM - MARGIN - 1e-9) and bool(
        high[1] <= MARGIN + 1e-9
    )


@pytest.mark.parametrize("name", VIEWS)
@pytest.mark.parametrize("start", [(0.0, 0.6), (0.3, -0.7), (-0.8, 0.1), (0.0, 0.0)])
def test_robot_and_board_stay_in_the_picture(name: str, start: tuple[float, float]) -> None:
    robot, board = walk(start)
    path = camera_path(VIEWS[name], robot, board, 30.0, ASPECT, STEP)
    assert inside(path.project(robot, ASPECT))
    assert inside(path.project(board, ASPECT))
    assert path.position[:, 2].min() > 0.2


@pytest.mark.parametrize("name", ["follow", "side"])
@pytest.mark.parametrize("start", [(0.0, 0.6), (0.3, -0.7), (2.5, 1.5)])
def test_the_robot_fills_a_good_part_of_the_picture(name: str, start: tuple[float, float]) -> None:
    robot, board = walk(start)
    seen = camera_path(VIEWS[name], robot, board, 0.0, ASPECT, STEP).project(robot, ASPECT)
    width, height = np.moveaxis((seen.max(1) - seen.min(1)) / 2, 1, 0)
    larger = np.maximum(width, height)
    assert larger.min() > (0.4 if np.hypot(*start) < 1 else 0.2)
    assert larger[-25:].min() > 0.6


@pytest.mark.parametrize("name", ["follow", "side", "top"])
def test_a_camera_that_follows_moves_smoothly(name: str) -> None:
    robot, board = walk((0.3, -0.7))
    position = camera_path(VIEWS[name], robot, board, 0.0, ASPECT, STEP).position
    velocity = np.diff(position, axis=0) / STEP
    acceleration = np.diff(velocity, axis=0) / STEP
    assert np.linalg.norm(velocity, axis=1).max() < 1.5
    assert np.linalg.norm(acceleration, axis=1).max() < 3
    assert np.ptp(position, axis=0).max() > 0.05  # it does follow
    # The robot itself is shaken by far more.
    assert np.linalg.norm(np.diff(robot.mean(1), 2, axis=0), axis=1).max() / STEP**2 > 40


def test_a_fixed_camera_stands_still() -> None:
    robot, board = walk((0.3, -0.7))
    path = camera_path(VIEWS["fixed"], robot, board, 0.0, ASPECT, STEP)
    np.testing.assert_allclose(path.position, np.broadcast_to(path.position[0], path.position.shape), atol=1e-12)


def test_a_fixed_camera_stands_no_farther_than_needed() -> None:
    robot, board = walk((0.3, -0.7))
    path = camera_path(VIEWS["fixed"], robot, board, 0.0, ASPECT, STEP)
    seen = np.concatenate((path.project(robot, ASPECT), path.project(board, ASPECT)), 1)
    low, high = seen.min((0, 1)), seen.max((0, 1))
    across = np.isclose([low[0], high[0]], [-MARGIN, MARGIN]).all()
    upright = np.isclose([low[1], high[1]], [LABEL_ROOM - MARGIN, MARGIN]).all()
    assert across or upright


def test_a_board_far_away_does_not_make_the_robot_small() -> None:
    near, board = walk((REACH, 0.0), jitter=0.0)
    far, _ = walk((4.0, 0.0), jitter=0.0)
    sizes = [
        np.ptp(camera_path(VIEWS["follow"], robot, board, 0.0, ASPECT, STEP).project(robot, ASPECT)[0], axis=0).max()
        for robot in (near, far)
    ]
    assert sizes[1] > 0.7 * sizes[0]


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("heading", [0.0, 90.0])
def test_the_robot_does_not_stand_before_the_board(side: int, heading: float) -> None:
    turn = np.radians(heading)
    away = side * 0.8 * np.array([-np.sin(turn), np.cos(turn)])
    robot, board = walk((away[0], away[1]))
    path = camera_path(VIEWS["follow"], robot, board, heading, ASPECT, STEP)
    depth = [((points[0].mean(0) - path.position[0]) @ path.axes[2]) for points in (robot, board)]
    assert depth[0] > depth[1]


def test_the_camera_of_mujoco_is_the_one_that_was_computed() -> None:
    robot, board = walk((0.3, -0.7))
    path = camera_path(VIEWS["follow"], robot, board, 0.0, ASPECT, STEP)
    camera = path[40]
    azimuth, elevation = np.radians([camera.azimuth, camera.elevation])
    flat = np.cos(elevation)
    forward = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
    np.testing.assert_allclose(camera.lookat - camera.distance * forward, path.position[40], atol=1e-9)


@pytest.mark.parametrize("steps", [1, 2, 5])
def test_short_episodes_have_a_path(steps: int) -> None:
    robot, board = walk((0.3, -0.7), steps)
    for view in VIEWS.values():
        path = camera_path(view, robot, board, 0.0, ASPECT, STEP)
        assert path.position.shape == (steps, 3)
        assert inside(path.project(robot, ASPECT))
