"""Labels and filmstrips."""

from __future__ import annotations

import defaults
import numpy as np
import pytest
from PIL import Image

from skatemount.rendering.overlay import AIR, DECK, FAILED, GROUND, Frame, choose_frames, draw_overlay, filmstrip


def moment(
    time: float = 1.0, mounted: bool = False, deck: str = "0000", touching: str = "0000", **outcome: object
) -> Frame:
    def flags(text: str) -> list[bool]:
        return [c == "1" for c in text]

    state = "mounted" if mounted else ""
    return Frame(
        time, defaults.LAYOUT.legs, flags(deck), flags(touching), state, np.zeros(0), np.zeros((0, 3)), **outcome
    )


def count(picture: Image.Image, color: tuple[int, int, int], within: int = 0) -> int:
    return int((np.abs(np.asarray(picture, dtype=int) - color) <= within).all(-1).sum())


def test_the_label_shows_each_foot() -> None:
    picture = Image.new("RGB", (640, 480), (120, 10, 10))
    pixels = [count(draw_overlay(picture, moment(deck=deck)), DECK) for deck in ("0000", "0100", "1111")]
    assert pixels[0] == 0 < pixels[1]
    assert pixels[2] == pytest.approx(4 * pixels[1], rel=0.15)
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
    colors = [(i * 40, 0, 0) for i in range(6)]
    strip = filmstrip([Image.new("RGB", (30, 20), c) for c in colors], columns=3, gap=2)
    assert strip.size == (3 * 30 + 2 * 2, 2 * 20 + 2)
    corners = [strip.getpixel((32 * (i % 3), 22 * (i // 3))) for i in range(6)]
    assert corners == colors
    assert strip.getpixel((31, 0)) == (255, 255, 255)


def test_nothing_is_said_of_contacts_at_the_start() -> None:
    picture = Image.new("RGB", (640, 480), (120, 10, 10))
    start = draw_overlay(picture, moment(time=0.0, mounted=True, deck="1100"))
    air = draw_overlay(picture, moment(time=0.04))
    assert count(start, DECK) == 0
    # The letters are light at the start, and gray for a foot in the air.
    assert count(start, GROUND, 40) > 1.3 * count(air, GROUND, 40)
    assert count(start, DECK, 40) == count(air, DECK, 40) == 0
    assert count(air, AIR, 10) > 0


def test_the_outcome_stands_beside_the_feet() -> None:
    picture = Image.new("RGB", (640, 480), (120, 10, 10))
    plain = draw_overlay(picture, moment())
    failed = draw_overlay(picture, moment(outcome="failed: tilt"))
    assert count(failed, FAILED) > 0 == count(plain, FAILED)
    succeeded = draw_overlay(picture, moment(outcome="success", succeeded=True))
    assert count(succeeded, DECK) > 0 == count(succeeded, FAILED)


@pytest.mark.parametrize("size", [(160, 120), (160, 2160), (640, 360), (1920, 1080)])
def test_a_label_fits_into_a_picture_of_any_size(size: tuple[int, int]) -> None:
    picture = Image.new("RGB", size, (120, 10, 10))
    frame = moment(12.34, mounted=True, deck="1111", outcome="failed: not mounted at the time limit")
    changed = np.argwhere((np.asarray(draw_overlay(picture, frame)) != (120, 10, 10)).any(-1))
    assert changed.min(0)[0] > 0.6 * size[1]
    assert changed.max(0)[0] < size[1] - 1
    assert changed.max(0)[1] < size[0] - 1
