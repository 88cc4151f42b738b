"""Pictures of the scene; needs OpenGL without a display."""

from __future__ import annotations

import os
from collections.abc import Iterator

import defaults
import mujoco
import numpy as np
import pytest

from skatemount.envs.scene import Scene
from skatemount.rendering.camera import VIEWS, CameraPath, camera_path
from skatemount.rendering.overlay import Frame
from skatemount.rendering.playback import visible_points
from skatemount.rendering.renderer import EpisodeRenderer

pytestmark = pytest.mark.skipif(
    os.environ.get("MUJOCO_GL") not in ("egl", "osmesa"), reason="needs OpenGL without a display"
)
WIDTH, HEIGHT = 160, 120


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene(defaults.robot(), defaults.board(), defaults.physics())


@pytest.fixture(scope="module")
def model(scene: Scene) -> mujoco.MjModel:
    return scene.compile()


@pytest.fixture(scope="module")
def painter(scene: Scene, model: mujoco.MjModel) -> Iterator[EpisodeRenderer]:
    feet = [model.geom(geom.full_identifier).id for geom in scene.robot.foot_geoms]
    painter = EpisodeRenderer(model, feet, WIDTH, HEIGHT)
    yield painter
    painter.close()


def frame(model: mujoco.MjModel, on_deck: bool = False) -> Frame:
    """The robot beside the board, as the model has it."""
    return Frame(
        1.0, defaults.LAYOUT.legs, [on_deck] * 4, [True] * 4, "", model.qpos0.copy(), np.zeros((model.nmocap, 3))
    )


def path_of(scene: Scene, model: mujoco.MjModel) -> tuple[CameraPath, list[np.ndarray]]:
    roots = [
        int(model.body_rootid[model.body(each.full_identifier).id]) for each in (scene.robot_frame, scene.board_frame)
    ]
    points = visible_points(model, [frame(model)], roots)
    return camera_path(VIEWS["follow"], *points, 0.0, WIDTH / HEIGHT, 0.04), points


def mean_color(picture: np.ndarray, projected: np.ndarray) -> np.ndarray:
    """Return the mean color of a few pixels around a projected point."""
    x, y = (projected[0] + 1) / 2 * WIDTH, (1 - projected[1]) / 2 * HEIGHT
    return picture[round(y) - 1 : round(y) + 2, round(x) - 1 : round(x) + 2].reshape(-1, 3).mean(0)


def test_robot_deck_and_floor_have_colors_of_their_own(
    scene: Scene, model: mujoco.MjModel, painter: EpisodeRenderer
) -> None:
    path, points = path_of(scene, model)
    picture = np.asarray(painter.draw(frame(model), path[0]), dtype=float)
    assert picture.shape == (HEIGHT, WIDTH, 3)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    # The end of the trunk's shell on top, the middle of the deck's near half, and the floor at the bottom corner.
    trunk = data.body(scene.robot.trunk.full_identifier)
    top = trunk.xpos + trunk.xmat.reshape(3, 3) @ [0.19, 0.03, 0.044]
    deck = data.site(scene.board.deck_site.full_identifier).xpos
    colors = [mean_color(picture, path.project(point[None, None], WIDTH / HEIGHT)[0, 0]) for point in (top, deck)]
    colors.append(picture[-6:-3, -6:-3].reshape(-1, 3).mean(0))
    for i in range(3):
        assert np.abs(colors[i] - colors[i - 1]).max() > 40


def test_feet_on_the_deck_are_green(scene: Scene, model: mujoco.MjModel, painter: EpisodeRenderer) -> None:
    path, _ = path_of(scene, model)
    plain, painted = (np.asarray(painter.draw(frame(model, on_deck), path[0]), dtype=int) for on_deck in (False, True))

    def green(picture: np.ndarray) -> int:
        return int(((picture[..., 1] > picture[..., 0] + 50) & (picture[..., 1] > picture[..., 2] + 20)).sum())

    assert green(plain) == 0
    assert green(painted) > 15


def test_the_picture_shows_what_the_camera_path_says(
    scene: Scene, model: mujoco.MjModel, painter: EpisodeRenderer
) -> None:
    """Robot and board are where the path projects them: outside their boxes the picture is all floor."""
    path, points = path_of(scene, model)
    with_subjects = np.asarray(painter.draw(frame(model), path[0]), dtype=int)
    away = frame(model)
    away.qpos[[0, 1]] += 100.0  # of the robot's free joint, which is the first
    without_robot = np.asarray(painter.draw(away, path[0]), dtype=int)
    changed = np.argwhere(np.abs(with_subjects - without_robot).max(-1) > 60)
    seen = path.project(points[0], WIDTH / HEIGHT)[0]
    left, right = ((seen[:, 0].min() + 1) / 2 * WIDTH, (seen[:, 0].max() + 1) / 2 * WIDTH)
    top = (1 - seen[:, 1].max()) / 2 * HEIGHT
    assert abs(changed[:, 0].min() - top) < 4
    assert changed[:, 1].min() > left - 4 and changed[:, 1].max() < right + 4
    assert np.ptp(changed[:, 1]) > 0.8 * (right - left)


def test_the_model_stays_as_it_was(scene: Scene, model: mujoco.MjModel, painter: EpisodeRenderer) -> None:
    lights, fovy, samples = model.light_pos.copy(), model.vis.global_.fovy, model.vis.quality.offsamples
    path, _ = path_of(scene, model)
    painter.draw(frame(model), path[0])
    np.testing.assert_array_equal(model.light_pos, lights)
    assert (model.vis.global_.fovy, model.vis.quality.offsamples) == (fovy, samples)
