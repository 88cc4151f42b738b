"""The moments of a picture, chosen in made-up episodes."""

from __future__ import annotations

from collections.abc import Sequence

import defaults
import numpy as np
import pytest

from skatemount.rendering.moments import choose_moments
from skatemount.rendering.overlay import Frame

STEP = 0.04


def episode(feet: Sequence[int], mounted: Sequence[int] = (), outcome: str = "success") -> list[Frame]:
    """Return an episode with so many feet on the deck in each frame.

    Args:
        feet: Feet on the deck.
        mounted: Frames in which the robot is mounted.
        outcome: The end.
    """
    legs = defaults.LAYOUT.legs
    frames = [
        Frame(i * STEP, legs, [k < n for k in range(4)], [True] * 4, "mounted" if i in mounted else "", *POSE)
        for i, n in enumerate(feet)
    ]
    frames[-1].outcome, frames[-1].succeeded = outcome, outcome == "success"
    return frames


POSE = (np.zeros(0), np.zeros((0, 3)))
FAILED = "failed: board tipped over"


def told(frames: Sequence[Frame], count: int = 6) -> dict[str, int]:
    """Return the frames by the names of their moments, and check what holds for any choice."""
    moments = choose_moments(frames, count)
    indices = [each.index for each in moments]
    assert indices == sorted(set(indices)) and indices[-1] == len(frames) - 1
    assert len(moments) == min(count, len(frames))
    return {each.name or str(each.index): each.index for each in moments}


def test_a_mounting_has_the_six_moments_of_the_paper() -> None:
    #                0 to 19   20 to 24  25 to 39   40 to 59   60 to 99
    frames = episode([0] * 20 + [1] * 5 + [2] * 15 + [3] * 20 + [4] * 40, range(60, 100))
    assert told(frames) == {
        "approach": 10,
        "first contact": 20,
        "transition": 25,
        "progress": 40,
        "near completion": 59,
        "mounted": 99,
    }


def test_only_the_mounting_that_lasts_counts() -> None:
    frames = episode([0] * 20 + [1, 2, 3] + [4] * 20 + [3] * 17 + [4] * 40, [*range(25, 43), *range(60, 100)])
    assert told(frames)["near completion"] == 59
    assert told(frames)["progress"] == 22


def test_feet_that_step_on_together_leave_no_gap() -> None:
    frames = episode([0] * 20 + [1] * 10 + [3] * 30 + [4] * 40, range(60, 100))
    assert told(frames) == {
        "approach": 10,
        "first contact": 20,
        "transition": 30,
        "progress": 44,
        "near completion": 59,
        "mounted": 99,
    }


def test_progress_is_before_the_robot_is_mounted() -> None:
    frames = episode([0] * 20 + [1] * 10 + [2] * 5 + [4] * 5 + [3] * 20 + [4] * 40, [*range(36, 42), *range(60, 100)])
    assert told(frames)["progress"] == 35
    frames = episode([0] * 20 + [1] * 10 + [2] * 5 + [4] * 5 + [3] * 20 + [4] * 40, [*range(35, 42), *range(60, 100)])
    assert told(frames)["progress"] == 42


def test_what_did_not_happen_is_made_up_for_in_the_longest_gaps() -> None:
    names = told(episode([0] * 20 + [4] * 40 + [3] * 10 + [4] * 30, range(70, 100)))
    assert list(names) == ["start", "approach", "first contact", "44", "near completion", "mounted"]


def test_a_failure_shows_what_happened_and_how_it_ended() -> None:
    frames = episode([0] * 20 + [1] * 5 + [2] * 25 + [0] * 11, outcome=FAILED)
    names = told(frames)
    assert (names["approach"], names["first contact"], names["transition"]) == (10, 20, 25)
    assert (names["before the end"], names["the end"]) == (50, 60)
    assert len(names) == 6


def test_a_contact_just_before_the_end_comes_before_nothing_else() -> None:
    names = told(episode([0] * 21 + [1] * 9, outcome=FAILED))
    assert (names["first contact"], names["the end"]) == (21, 29)
    assert "before the end" not in names and list(names)[0] == "start"


def test_a_failure_that_stood_for_a_time_shows_it() -> None:
    frames = episode([0] * 20 + [1, 2, 3] + [4] * 40 + [2] * 38, range(30, 60), FAILED)
    names = told(frames)
    assert names["mounted for a time"] == 59
    assert "mounted" not in names and "near completion" not in names


def test_mounted_too_late_is_a_failure() -> None:
    frames = episode([0] * 80 + [1, 2, 3] + [4] * 18, range(90, 101), "failed: not mounted at the time limit")
    names = told(frames)
    assert names["the end"] == 100 and "mounted" not in names
    assert names["first contact"] == 80


def test_a_failure_without_contact_is_even() -> None:
    names = told(episode([0] * 101, outcome=FAILED))
    assert (names["approach"], names["before the end"], names["the end"]) == (50, 90, 100)
    assert len(names) == 6


def test_a_robot_that_starts_on_the_deck_has_no_approach() -> None:
    for settled in (1, 3):
        names = told(episode([4] * 101, range(settled, 101)))
        assert list(names) == ["start", "20", "40", "60", "80", "mounted"]
    assert "approach" not in told(episode([4] * 101, outcome=FAILED))


def test_a_task_without_a_state_is_even_when_it_succeeds() -> None:
    assert list(told(episode([0] * 101))) == ["start", "20", "40", "60", "80", "the end"]


@pytest.mark.parametrize("length", [1, 2, 3, 5])
def test_short_episodes_show_each_frame_once(length: int) -> None:
    for outcome in ("success", FAILED):
        for mounted in ((), range(1, length)):
            moments = choose_moments(episode([min(i, 4) for i in range(length)], mounted, outcome))
            assert [each.index for each in moments] == list(range(length))


def test_fewer_moments_keep_the_end() -> None:
    frames = episode([0] * 20 + [1] * 5 + [2] * 15 + [3] * 20 + [4] * 40, range(60, 100))
    assert list(told(frames, 4)) == ["approach", "first contact", "near completion", "mounted"]
