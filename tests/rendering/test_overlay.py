"""Labels, captions and titles."""

from __future__ import annotations

import defaults
import numpy as np
import pytest
from PIL import Image

from skatemount.rendering.overlay import (
    AIR,
    DECK,
    FAILED,
    GROUND,
    PUSH,
    TEXT,
    Frame,
    draw_caption,
    draw_overlay,
    draw_title,
    rooms,
)


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


def test_a_push_is_told_until_the_episode_ends() -> None:
    picture = Image.new("RGB", (640, 480), (120, 10, 10))
    assert count(draw_overlay(picture, moment(push=0.31)), PUSH) > 0 == count(draw_overlay(picture, moment()), PUSH)
    over = draw_overlay(picture, moment(push=0.31, outcome="failed: robot fell"))
    assert count(over, PUSH) == 0 < count(over, FAILED)


LONG = "a run with a very long name, which somebody gave it, on approach-unfixed, seed 0, episode 12, largest push 0.5"


@pytest.mark.parametrize("size", [(160, 120), (356, 251), (720, 540), (1920, 1080)])
@pytest.mark.parametrize("text", ["episode 7", LONG])
def test_a_caption_takes_the_room_at_the_top_that_is_kept_free(size: tuple[int, int], text: str) -> None:
    picture = Image.new("RGB", size, (120, 10, 10))
    changed = np.argwhere((np.asarray(draw_caption(picture, text)) != (120, 10, 10)).any(-1))
    assert 0 < changed.min() and changed.max(0)[1] < size[0] - 1
    assert changed.max(0)[0] < rooms(size, True)[1] * size[1] / 2
    assert rooms(size, False)[1] == 0
    labeled = draw_overlay(picture, moment(12.34, mounted=True, deck="1111"))
    changed = np.argwhere((np.asarray(labeled) != (120, 10, 10)).any(-1))
    assert changed.min(0)[0] >= size[1] - rooms(size, True)[0] * size[1] / 2 - 1
    assert draw_caption(picture, "") is picture


def test_a_title_is_a_bar_with_text() -> None:
    bar, empty = draw_title("six moments", 400, 30), draw_title("", 400, 30)
    assert bar.size == empty.size == (400, 30)
    assert count(bar, TEXT) > 0 == count(empty, TEXT)
    red = draw_title(LONG, 400, 30, FAILED)
    assert count(red, FAILED, 30) > 0 == count(red, TEXT, 30)
