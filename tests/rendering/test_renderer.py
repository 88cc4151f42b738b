"""Labels, filmstrips and the camera's place; what needs no OpenGL."""

from __future__ import annotations

import math

import numpy as np
import pytest
from PIL import Image

from skatemount.rendering.renderer import (
    DECK,
    FIELD_OF_VIEW,
    GROUND,
    LABEL_ROOM,
    MARGIN,
    Frame,
    choose_frames,
    draw_overlay,
    filmstrip,
    frame_camera,
)


def moment(time: float = 0.0, mounted: bool = False, deck: str = "0000", touching: str = "0000") -> Frame:
    def flags(text: str) -> list[bool]:
        return [c == "1" for c in text]

    return Frame(time, flags(deck), flags(touching), mounted, np.zeros(0), np.zeros((0, 3)))


def project(camera: object, points: np.ndarray, aspect: float) -> np.ndarray:
    """Points in the picture, its edges at -1 and 1."""
    azimuth, elevation = math.radians(camera.azimuth), math.radians(camera.elevation)
    flat = math.cos(elevation)
    forward = np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(elevation)])
    right = np.cross(forward, (0, 0, 1))
    right /= np.linalg.norm(right)
    seen = points - (camera.lookat - camera.distance * forward)
    up = np.cross(right, forward)
    reach = seen @ forward * math.tan(math.radians(FIELD_OF_VIEW / 2))
    return np.stack((seen @ right / reach / aspect, seen @ up / reach), 1)


@pytest.mark.parametrize("spread", [(0.5, 0.5, 0.2), (3.0, 0.2, 0.2), (0.1, 0.1, 2.0)])
def test_the_camera_sees_all_points_and_stands_no_farther_than_needed(spread: tuple) -> None:
    points = np.random.default_rng(0).normal(size=(40, 3)) * spread
    camera = frame_camera(points, 4 / 3)
    seen = project(camera, points, 4 / 3)
    assert (np.abs(seen[:, 0]) <= MARGIN + 1e-9).all()
    assert (seen[:, 1] <= MARGIN + 1e-9).all()
    assert (seen[:, 1] >= LABEL_ROOM - MARGIN - 1e-9).all()
    sideways = np.isclose([seen[:, 0].min(), seen[:, 0].max()], [-MARGIN, MARGIN]).all()
    upright = np.isclose([seen[:, 1].min(), seen[:, 1].max()], [LABEL_ROOM - MARGIN, MARGIN]).all()
    assert sideways or upright


def count(picture: Image.Image, colour: tuple[int, int, int]) -> int:
    return int((np.asarray(picture) == colour).all(-1).sum())


def test_the_label_shows_each_foot() -> None:
    picture = Image.new("RGB", (640, 480), (120, 10, 10))
    pixels = [count(draw_overlay(picture, moment(deck=deck)), DECK) for deck in ("0000", "0100", "1111")]
    assert pixels[0] == 0 < pixels[1]
    assert pixels[2] == pytest.approx(4 * pixels[1], rel=0.1)
    touching = draw_overlay(picture, moment(deck="1000", touching="1100"))
    assert count(touching, GROUND) > 0.5 * count(touching, DECK) > 0


def test_the_label_stays_within_a_picture_that_is_left_as_it_was() -> None:
    picture = Image.new("RGB", (640, 480), (120, 10, 10))
    result = draw_overlay(picture, moment(12.34, mounted=True, deck="1111"))
    assert result.size == picture.size
    assert count(picture, (120, 10, 10)) == 640 * 480
    changed = np.argwhere((np.asarray(result) != (120, 10, 10)).any(-1))
    assert changed.min(0)[0] > 0.7 * 480
    assert 0 < changed.min() and changed.max(0)[0] < 479 and changed.max(0)[1] < 639
    plain = draw_overlay(picture, moment(12.34, deck="1111"))
    assert count(result, DECK) > count(plain, DECK)  # the word


def test_a_filmstrip_shows_the_mounting_closely() -> None:
    episode = [moment(i * 0.1, mounted=i >= 16) for i in range(101)]
    chosen = choose_frames(episode)
    assert len(chosen) == 6
    assert (chosen[0], chosen[-1]) == (0, 100)
    assert chosen[-2] == 21  # half a second after it


def test_a_filmstrip_of_a_failure_is_even() -> None:
    # Mounted for a while, but not in the end.
    episode = [moment(i * 0.1, mounted=20 < i < 40) for i in range(51)]
    assert choose_frames(episode) == [0, 10, 20, 30, 40, 50]


def test_short_episodes_show_each_moment_once() -> None:
    assert choose_frames([moment(i * 0.1) for i in range(3)]) == [0, 1, 2]
    assert choose_frames([moment(i * 0.1, mounted=True) for i in range(2)]) == [0, 1]


def test_filmstrip_goes_row_by_row() -> None:
    colours = [(i * 40, 0, 0) for i in range(6)]
    strip = filmstrip([Image.new("RGB", (30, 20), c) for c in colours], columns=3, gap=2)
    assert strip.size == (3 * 30 + 2 * 2, 2 * 20 + 2)
    corners = [strip.getpixel((32 * (i % 3), 22 * (i // 3))) for i in range(6)]
    assert corners == colours
    assert strip.getpixel((31, 0)) == (255, 255, 255)
