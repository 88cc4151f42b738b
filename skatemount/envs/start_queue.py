"""Queues of start states that are drawn ahead."""

from __future__ import annotations

import torch
from torch import Tensor

from skatemount.envs.physics.base import StartState
from skatemount.envs.starts import StartSampler, StartTransform

BATCH = 1024
"""Start states in a batch, at least."""


class StartQueue:
    """A queue of start states that are drawn ahead.

    Drawing a few start states costs as much as drawing a thousand, so they are drawn in batches. Worlds take them in
    the order of drawing, which depends on the generator only.

    Args:
        sampler: Source of the start states.
        size: Number of start states in a batch.
        generator: Source of randomness.
        transform: Applied to every batch; no transform if None.
    """

    def __init__(
        self, sampler: StartSampler, size: int, generator: torch.Generator, transform: StartTransform | None = None
    ):
        self._sampler = sampler
        self._size = size
        self._generator = generator
        self._transform = transform
        self._starts: StartState | None = None
        self._next = 0

    def take_for(self, worlds: Tensor) -> StartState:
        """Take start states for ``[K]`` worlds that are reset, which all have the same board."""
        return self.take(len(worlds))

    def take(self, count: int) -> StartState:
        """Take the next start states from the queue.

        Args:
            count: Number of start states.

        Returns:
            ``[count]`` start states.
        """
        while self._starts is None or self._next + count > len(self._starts):
            more = self._sampler.draw(self._size, self._generator)
            if self._transform is not None:
                more = self._transform(more, self._generator)
            # The rest of the last batch comes first, so that no start state is skipped.
            self._starts = more if self._starts is None else StartState.cat([self._starts[self._next :], more])
            self._next = 0
        taken = slice(self._next, self._next + count)
        self._next += count
        return self._starts[taken]

    def state_dict(self) -> dict[str, Tensor]:
        """Return the start states that are left, by field; empty if none are drawn yet."""
        return {} if self._starts is None else self._starts[self._next :].state_dict()

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restore what `state_dict` returned."""
        self._starts = StartState.from_state_dict(state, self._generator.device) if state else None
        self._next = 0


class WorldStartQueue:
    """A queue of start states for each world, which fit its own board, drawn ahead for all worlds together.

    When a world has none left, the queues of all worlds are filled again in one draw.

    Args:
        sampler: Source of the start states.
        num_worlds: Number of worlds, N.
        depth: Number of start states in the full queue of a world.
        generator: Source of randomness.
        transform: Applied to every draw; no transform if None.
    """

    def __init__(
        self,
        sampler: StartSampler,
        num_worlds: int,
        depth: int,
        generator: torch.Generator,
        transform: StartTransform | None = None,
    ):
        self._sampler, self._transform, self._generator = sampler, transform, generator
        self._num_worlds, self._depth = num_worlds, depth
        self._starts: StartState | None = None
        self._left = torch.zeros(num_worlds, dtype=torch.int64, device=generator.device)

    def take_for(self, worlds: Tensor) -> StartState:
        """Take the next start state of each of some worlds.

        Args:
            worlds: ``[K]`` int64, each world at most once.

        Returns:
            ``[K]`` start states.
        """
        if self._starts is None or not bool((self._left[worlds] > 0).all()):
            self._fill()
        assert self._starts is not None
        self._left[worlds] -= 1
        return self._starts[self._left[worlds] * self._num_worlds + worlds]

    def _fill(self) -> None:
        places = torch.arange(self._depth * self._num_worlds, device=self._left.device)
        worlds = places % self._num_worlds
        # The start states of a world lie at i N + world, and the first `_left` of them are still to be used.
        used = places // self._num_worlds >= self._left[worlds]
        places, worlds = places[used], worlds[used]
        drawn = self._sampler.draw(len(worlds), self._generator, worlds)
        if self._transform is not None:
            drawn = self._transform(drawn, self._generator)
        if self._starts is None:
            self._starts = drawn
        else:
            left = (~used).nonzero().squeeze(1)
            order = torch.cat((left, places)).argsort()
            self._starts = StartState.cat([self._starts[left], drawn])[order]
        self._left.fill_(self._depth)

    def state_dict(self) -> dict[str, Tensor]:
        """Return the start states by field, and how many each world has left; empty if none are drawn yet."""
        return {} if self._starts is None else self._starts.state_dict() | {"left": self._left.clone()}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restore what `state_dict` returned."""
        fields = {name: value for name, value in state.items() if name != "left"}
        self._starts = StartState.from_state_dict(fields, self._generator.device) if fields else None
        self._left = state["left"].to(self._left) if fields else torch.zeros_like(self._left)


def make_queue(
    sampler: StartSampler, num_worlds: int, generator: torch.Generator, transform: StartTransform | None = None
) -> StartQueue | WorldStartQueue:
    """Make the queue of an environment.

    Args:
        sampler: Source of the start states.
        num_worlds: Number of worlds.
        generator: Source of randomness.
        transform: Applied to every draw; no transform if None.
    """
    if sampler.boards_vary:
        return WorldStartQueue(sampler, num_worlds, max(2, BATCH // num_worlds), generator, transform)
    return StartQueue(sampler, max(num_worlds, BATCH), generator, transform)
