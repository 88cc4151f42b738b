"""The moments of an episode that a picture shows: from the approach to the end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from skatemount.rendering.overlay import Frame

COUNT = 6
"""Moments of a picture, as many as in figure 3 of the paper."""

AT_ONCE = 0.2
"""Time within which three feet press on the deck if the robot starts on it, s."""

BEFORE_END = 0.4
"""Time from the moment ``before the end`` of a failure to its end, s."""

_LESSER = ("transition", "progress", "")
"""Moments that are left out first if there are too many."""


@dataclass(frozen=True)
class Moment:
    """A frame of an episode that shows something.

    Attributes:
        index: Index of the frame.
        name: Name of the moment; empty for a frame between two others.
    """

    index: int
    name: str = ""


def choose_moments(frames: Sequence[Frame], count: int = COUNT) -> list[Moment]:
    """Choose the moments of an episode by the feet that press on the deck and the task's state.

    ==================  ==========================================================================================
    approach            half of the time until the first contact, or of the episode without any contact
    first contact       a foot presses on the deck for the first time
    transition          two feet do for the first time
    progress            three feet do for the first time before the robot is in the task's state; of a success without
                        such a frame, half of the time from the transition to the near completion
    near completion     the last frame before the robot comes to the task's state, in which it then stays
    the task's word     the last frame, such as ``mounted``
    ==================  ==========================================================================================

    A failure has the first four of them as far as they happen, the last frame in the task's state if there is one
    (``mounted for a time``), ``before the end``, and ``the end``. The start, and frames in the middle of the longest
    gaps, make up for what did not happen. A robot that starts on the deck has no approach: its moments are evenly
    spaced.

    Args:
        frames: The episode.
        count: Number of moments, at least 2.

    Returns:
        Moments in order of time; fewer than ``count`` only if the episode is shorter.
    """
    feet = [0, *(sum(frame.on_deck) for frame in frames[1:])]  # nothing is known of the contacts at the start
    last = len(frames) - 1
    final = frames[last]
    first = _first(feet, 1)
    if first is not None and any(n >= 3 for n, each in zip(feet, frames, strict=True) if each.time <= AT_ONCE):
        return _even(frames, count)
    approach = Moment((last if first is None else first) // 2, "approach")
    climb = [approach, *_climb(feet, frames)]
    if not final.succeeded:
        return _filled([*climb, *_failure(frames, climb[-1].index)], last, count)
    settled = last
    while settled > 0 and frames[settled - 1].state:
        settled -= 1
    if first is None or settled == 0 or not final.state:
        return _even(frames, count)
    climb = [each for each in climb if each.index < settled - 1]
    if climb and climb[-1].name == "transition" and settled - climb[-1].index > 2:
        climb.append(Moment((climb[-1].index + settled - 1) // 2, "progress"))
    near = [Moment(settled - 1, "near completion")] if settled - 1 > first else []
    return _filled([*climb, *near, Moment(last, final.state)], last, count)


def _first(feet: Sequence[int], number: int) -> int | None:
    """Return the first frame with at least so many feet on the deck."""
    return next((i for i, each in enumerate(feet) if each >= number), None)


def _climb(feet: Sequence[int], frames: Sequence[Frame]) -> list[Moment]:
    """Return the first frames with one, two, and three feet on the deck, each once under its first name."""
    moments: dict[int, Moment] = {}
    begun = [0 if each.state else number for number, each in zip(feet, frames, strict=True)]
    for number, name in enumerate(("first contact", "transition", "progress"), 1):
        if (index := _first(begun if number == 3 else feet, number)) is not None:
            moments.setdefault(index, Moment(index, name))
    return list(moments.values())


def _failure(frames: Sequence[Frame], climbed: int) -> list[Moment]:
    """Return the last moments of a failure.

    Args:
        frames: The episode.
        climbed: Index of the moment before them.
    """
    last = len(frames) - 1
    moments = [Moment(i, f"{each.state} for a time") for i, each in enumerate(frames) if each.state][-1:]
    moments = [] if frames[last].state else moments
    before = next(i for i, each in enumerate(frames) if each.time >= frames[last].time - BEFORE_END - 1e-6)
    if before > max([climbed, *(each.index for each in moments)]):
        moments.append(Moment(before, "before the end"))
    return [*moments, Moment(last, "the end")]


def _even(frames: Sequence[Frame], count: int) -> list[Moment]:
    """Return the first and the last frame and others at equal distances."""
    last = len(frames) - 1
    middle = [Moment(round(i * last / (count - 1))) for i in range(1, count - 1)]
    return _filled([Moment(0, "start"), *middle, Moment(last, frames[last].state or "the end")], last, count)


def _filled(moments: Sequence[Moment], last: int, count: int) -> list[Moment]:
    """Return as many moments as asked for, in order of time.

    Args:
        moments: Some in order of importance among those of one frame: the first keeps its name, but the end's stays.
        last: Index of the last frame.
        count: Number of moments.
    """
    chosen: dict[int, Moment] = {}
    for each in (moments[-1], *moments):
        chosen.setdefault(each.index, each)
    for index in [each.index for name in _LESSER for each in chosen.values() if each.name == name]:
        if len(chosen) > count:
            del chosen[index]
    while len(chosen) > count:
        del chosen[sorted(chosen)[-2]]
    if len(chosen) < count:
        chosen.setdefault(0, Moment(0, "start"))
    while len(chosen) < min(count, last + 1):
        known = sorted(chosen)
        gap, start = max((b - a, a) for a, b in zip(known, known[1:], strict=False))
        index = start + gap // 2
        chosen[index] = Moment(index)
    return [chosen[i] for i in sorted(chosen)]
