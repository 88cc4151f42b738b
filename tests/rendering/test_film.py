"""Films of made-up episodes: their pictures, their lengths, and where each episode is in them."""

from __future__ import annotations

import functools
import os
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import defaults
import numpy as np
import pytest
from PIL import Image

from skatemount.envs.config.physics import PhysicsConfig
from skatemount.envs.scene import Scene
from skatemount.rendering import film as films
from skatemount.rendering.film import Grid, default_film, moments_sheet, parts_of, save_sheet, timeline, write_film
from skatemount.rendering.overlay import Frame
from skatemount.rendering.playback import Episode, visible_points
from skatemount.utils.errors import ConfigError

needs_opengl = pytest.mark.skipif(
    os.environ.get("MUJOCO_GL") not in ("egl", "osmesa"), reason="needs OpenGL without a display"
)


def physics(step: float, substeps: int) -> PhysicsConfig:
    return cast(PhysicsConfig, SimpleNamespace(control_step=step, substeps=substeps))


@pytest.mark.parametrize(
    ("speed", "step", "substeps", "parts"),
    [
        (1.0, 0.04, 8, 1),
        (3.0, 0.04, 8, 1),
        (0.5, 0.04, 8, 2),
        (0.25, 0.04, 8, 4),
        (0.2, 0.04, 8, 8),  # five parts are not possible
        (0.05, 0.04, 8, 8),  # as smooth as the physics is
        (0.5, 0.02, 4, 1),
        (0.3, 0.04, 10, 5),
        (1.0, 0.1, 20, 1),
    ],
)
def test_a_slow_motion_has_enough_pictures(speed: float, step: float, substeps: int, parts: int) -> None:
    assert parts_of(default_film(speed=speed), physics(step, substeps)) == parts


def test_the_timeline_of_a_film() -> None:
    times, rate = timeline(1.0, 0.04, default_film())
    assert rate == 25 and times == pytest.approx(np.arange(26) * 0.04)
    times, rate = timeline(1.0, 0.04, default_film(speed=5.0))
    assert rate == pytest.approx(125 / 3) and times == pytest.approx([*(np.arange(0, 25, 3) * 0.04), 1.0])
    times, rate = timeline(1.0, 0.01, default_film(speed=0.25, start=0.2, end=0.6))
    assert rate == 25 and times == pytest.approx(np.arange(20, 61) * 0.01)
    assert timeline(1.0, 0.04, default_film(end=5.0))[0][-1] == pytest.approx(1.0)
    assert len(timeline(1.0, 0.02, default_film(), 30)[0]) == 26


def test_a_film_that_starts_after_the_end_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"^film.start=1.5 must be below 1.20 s, where the film ends$"):
        timeline(1.2, 0.04, default_film(start=1.5))


@pytest.mark.parametrize("title", [False, True])
@pytest.mark.parametrize("size", [(720, 540), (1920, 1080), (160, 120)])
def test_the_pictures_of_a_grid_do_not_overlap(size: tuple[int, int], title: bool) -> None:
    for count in range(1, 17):
        grid = Grid.of(count, *size, title)
        taken = np.zeros(size[::-1], int)
        for i in range(count):
            x, y = grid.place(i)
            assert y >= grid.title and x + grid.size[0] <= size[0] and y + grid.size[1] <= size[1]
            taken[y : y + grid.size[1], x : x + grid.size[0]] += 1
        assert taken.max() == 1 and min(grid.size) >= 16
    assert Grid.of(1, *size, False).size == size
    assert [Grid.of(n, 720, 540, False).columns for n in (2, 3, 4, 9, 12)] == [2, 2, 2, 3, 4]


SCENE = functools.cache(lambda: Scene(defaults.robot(), defaults.board(), defaults.physics()))


@pytest.fixture(scope="module")
def model() -> Any:
    return SCENE().compile()


def episode(model: Any, number: int, frames: int, **changes: Any) -> Episode:
    """Return an episode in which the robot moves sideways, and then succeeds."""
    scene = SCENE()
    shown = []
    for i in range(frames):
        qpos = model.qpos0.copy()
        qpos[1] += 0.01 * i + 0.1 * number
        deck = [i >= frames - 2] * 4
        shown.append(Frame(i * 0.04, defaults.LAYOUT.legs, deck, deck, "mounted" * deck[0], qpos, np.zeros((1, 3))))
    shown[-1].outcome, shown[-1].succeeded = "success", True
    roots = [
        int(model.body_rootid[model.body(each.full_identifier).id]) for each in (scene.robot_frame, scene.board_frame)
    ]
    robot, board = visible_points(model, shown, roots)
    feet = [model.geom(geom.full_identifier).id for geom in scene.robot.foot_geoms]
    told: dict[str, Any] = {"variant": "", "deck": "", "heading": 0.0, "control_step": 0.04, "parts": 1}
    told |= {"record": None, "summary": "succeeded"} | changes
    return Episode(number=number, frames=shown, model=model, feet=feet, robot=robot, board=board, **told)


def pictures_of(path: Path) -> list[np.ndarray]:
    import imageio_ffmpeg

    frames = imageio_ffmpeg.read_frames(str(path))
    width, height = next(frames)["size"]
    return [np.frombuffer(f, np.uint8).reshape(height, width, 3).astype(int) for f in frames]


@needs_opengl
def test_episodes_are_side_by_side_and_one_that_has_ended_stays(model: Any, tmp_path: Path) -> None:
    episodes = [episode(model, 3, 4), episode(model, 8, 7, variant="40ms")]
    said: list[str] = []
    settings = default_film(width=320, height=160, caption=False)
    write_film(episodes, settings, "", tmp_path / "film.mp4", say=said.append)
    shown = pictures_of(tmp_path / "film.mp4")
    assert len(shown) == 6 + round(films.HOLD * 25)
    left, right = ([picture[:, part] for picture in shown] for part in (slice(0, 150), slice(170, 320)))
    assert change(left[0], left[3]) > 0.005 and change(right[3], right[6]) > 0.005
    assert change(left[3], left[6]) == 0 == change(right[6], right[-1])
    assert len(said) == 2 and said[0].startswith("drawing 7 pictures of 320 x 160, about ")
    assert said[1].startswith("drawn in ")


def change(a: np.ndarray, b: np.ndarray) -> float:
    """Return the part of two pictures that differs by more than the losses of a film."""
    return float((np.abs(a - b).max(-1) > 40).mean())


@needs_opengl
def test_a_caption_tells_what_is_shown(model: Any, tmp_path: Path) -> None:
    assert films.caption_of(episode(model, 8, 2, variant="40ms", deck="deck 70 x 20 cm")) == (
        "episode 8, 40ms, deck 70 x 20 cm"
    )
    tops = []
    for caption in (False, True):
        settings = default_film(width=320, height=240, caption=caption)
        last = write_film([episode(model, 3, 2)], settings, "anywhere on far, seed 0", tmp_path / "film.mp4")
        assert last.size == (320, 240)
        tops.append(np.asarray(last, int)[5:20, 8:160])
    dark = [(top.max(-1) < 100).mean() for top in tops]
    assert dark[0] < 0.05 and dark[1] > 0.5


@needs_opengl
def test_sheets_show_one_episode_in_two_rows_and_several_in_a_row_each(model: Any, tmp_path: Path) -> None:
    one, two = episode(model, 3, 8), episode(model, 8, 7)
    sheet = moments_sheet([one], default_film(), "anywhere on far, seed 0")
    assert sheet.size == (3 * 640 + 2 * 8, 36 + 2 * 480 + 8)
    assert moments_sheet([one], default_film(caption=False), "", 160).size == (3 * 160 + 2 * 8, 2 * 120 + 8)
    rows = moments_sheet([one, two], default_film(), "anywhere on far, seed 0")
    assert rows.size == (6 * 288 + 5 * 8, 36 + 2 * (28 + 216))
    save_sheet(rows, tmp_path / "rows.png")
    with Image.open(tmp_path / "rows.png") as saved:
        assert saved.size == rows.size and saved.mode == "P"
        error = np.abs(np.asarray(saved.convert("RGB"), int) - np.asarray(rows, int))
    assert error.mean() < 8


@needs_opengl
def test_a_plain_background_is_one_color(model: Any, tmp_path: Path) -> None:
    def spread(background: str) -> float:
        settings = default_film(width=240, height=180, caption=False, background=background, camera="side")
        picture = np.asarray(write_film([episode(model, 3, 2)], settings, "", tmp_path / "film.mp4"), float)
        sky, floor = picture[:12].reshape(-1, 3), picture[60:120, -4:].reshape(-1, 3)
        return float(np.abs(np.median(sky, 0) - np.median(floor, 0)).max())

    assert spread("plain") < 8 < 30 < spread("floor")


@needs_opengl
def test_a_gif_has_the_pictures_of_the_film(model: Any, tmp_path: Path) -> None:
    shown = [episode(model, 3, 9)]
    settings = default_film(width=320, height=240, gif_width=160)
    sheet = moments_sheet(shown, settings, "", 160)
    last = write_film(shown, settings, "a title", tmp_path / "film.mp4", tmp_path / "film.gif", sheet)
    assert durations(tmp_path / "film.gif") == [80] * 4 + [1000 * films.HOLD]
    with Image.open(tmp_path / "film.gif") as gif:
        assert (gif.format, gif.size, gif.info["loop"]) == ("GIF", (160, 120), 0)
        gif.seek(gif.n_frames - 1)
        error = np.abs(np.asarray(gif.convert("RGB"), int) - np.asarray(last.resize((160, 120)), int))
    assert error.mean() < 8


def durations(path: Path) -> Sequence[float]:
    found = []
    with Image.open(path) as gif:
        for i in range(gif.n_frames):
            gif.seek(i)
            found.append(gif.info["duration"])
    return found


@needs_opengl
def test_full_hd(model: Any, tmp_path: Path) -> None:
    from skatemount.config.files import load_file

    sizes = {name: value for name, value in load_file("film", "1080p").items() if name != "defaults"}
    write_film([episode(model, 3, 2)], default_film(**sizes), "a title", tmp_path / "film.mp4")
    assert pictures_of(tmp_path / "film.mp4")[0].shape == (1080, 1920, 3)
