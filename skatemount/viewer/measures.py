"""Numbers that a live session shows: successes so far, recent reward terms, and the pace of the simulation."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from skatemount.evaluation.intervals import wilson_interval


@dataclass
class End:
    """The end of an episode.

    Attributes:
        world: Its world.
        seconds: Its duration, s.
        words: Its outcome in words.
        success: True if it succeeded.
    """

    world: int
    seconds: float
    words: str
    success: bool


class Tally:
    """Successes of the episodes so far.

    Episodes are counted in rounds: the n-th episode of a world counts once every world has ended its n-th. Otherwise
    short episodes, which are mostly failures, would be counted more often.

    Args:
        worlds: Number of worlds.
    """

    def __init__(self, worlds: int):
        self._results: list[list[bool]] = [[] for _ in range(worlds)]

    def add(self, world: int, success: bool) -> None:
        """Add the result of a world's episode."""
        self._results[world].append(success)

    @property
    def counted(self) -> tuple[int, int]:
        """Number of successes and number of episodes that count."""
        rounds = min(map(len, self._results))
        kept = [result for results in self._results for result in results[:rounds]]
        return sum(kept), len(kept)

    def __str__(self) -> str:
        successes, episodes = self.counted
        if not episodes:
            return "no round of episodes has ended yet"
        low, high = wilson_interval(successes, episodes)
        rate = successes / episodes
        return f"{rate:.0%} of {episodes} (95 % interval {100 * low:.0f} to {100 * high:.0f} %)"


class RewardHistory:
    """Reward terms of the last control steps, per second.

    Args:
        names: Names of the terms.
        worlds: Number of worlds.
        control_step: Time between two actions, s.
        seconds: Time that is remembered, s.
    """

    def __init__(self, names: Sequence[str], worlds: int, control_step: float, seconds: float = 10.0):
        self.names = list(names)
        self._step = control_step
        self._shape = len(self.names), worlds
        self._rows: deque[tuple[float, np.ndarray]] = deque(maxlen=max(2, round(seconds / control_step)))

    def add(self, time: float, terms: np.ndarray) -> None:
        """Add a control step.

        Args:
            time: Time of the session, s.
            terms: ``[terms, N]``, the weighted terms of the step.
        """
        self._rows.append((time, terms / self._step))

    def clear(self) -> None:
        """Forget every step."""
        self._rows.clear()

    def curves(self, world: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the times ``[T]``, s, and the terms of a world ``[terms, T]``, per second."""
        if not self._rows:
            return np.zeros(0), np.zeros((self._shape[0], 0))
        times, values = zip(*self._rows)
        return np.array(times), np.stack([each[:, world] for each in values], 1)

    def chosen(self, world: int, pattern: str, most: int) -> list[int]:
        """Return the indices of the terms to draw, the largest first.

        Args:
            world: The world whose terms are compared by their median size.
            pattern: Parts of names, separated by blanks or commas; every term if empty.
            most: Largest number of terms.
        """
        parts = pattern.replace(",", " ").split()
        fits = [i for i, name in enumerate(self.names) if not parts or any(part in name for part in parts)]
        _, values = self.curves(world)
        # The median, so that a single event, such as the end of an episode, does not hide the other terms.
        size = np.median(np.abs(values), 1) if values.size else np.zeros(len(self.names))
        return sorted(fits, key=lambda i: -size[i])[:most]


class Pace:
    """The times at which control steps are due.

    Args:
        clock: A steady clock, s.
    """

    def __init__(self, clock: Callable[[], float] = time.perf_counter):
        self._clock = clock
        self._next = clock()
        self._done: deque[tuple[float, float]] = deque(maxlen=200)

    def wait(self) -> float:
        """Return the time until the next step is due, s; 0 if it is."""
        return max(0.0, self._next - self._clock())

    def stepped(self, control_step: float, speed: float) -> None:
        """Count a step.

        Args:
            control_step: Simulated time of the step, s.
            speed: Simulated seconds in a second.
        """
        now = self._clock()
        # What a slow step or a pause has cost is not caught up with.
        self._next = max(self._next + control_step / speed, now)
        self._done.append((now, control_step))

    def restart(self) -> None:
        """Let the next step be due now, and forget the speed so far."""
        self._next = self._clock()
        self._done.clear()

    @property
    def speed(self) -> float | None:
        """Simulated seconds in a second over the last two seconds; None before there are any."""
        now = self._clock()
        recent = [(at, step) for at, step in self._done if now - at < 2.0]
        if len(recent) < 2 or recent[-1][0] <= recent[0][0]:
            return None
        return sum(step for _, step in recent[1:]) / (recent[-1][0] - recent[0][0])
