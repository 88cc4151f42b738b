"""`Ranks`: the processes that train one policy together, as the code that learns knows them."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from torch import Tensor, nn


class Ranks:
    """The processes that train one policy together. This class stands for a single process, so it changes nothing.

    `skatemount.training.distributed.JoinedRanks` stands for several. Every rank must call these methods in the same
    order, with tensors of the same shapes.

    Attributes:
        rank: Number of this process, from 0.
        size: Number of processes.
        command: The program that starts the processes, with its options.
    """

    rank: int = 0
    size: int = 1
    command: Sequence[str] = ("python",)

    @property
    def first(self) -> bool:
        """True on rank 0, which writes the run's folder, evaluates and prints."""
        return self.rank == 0

    def sum(self, *tensors: Tensor) -> None:
        """Replace tensors by their sums over all ranks, in place."""

    def mean(self, *tensors: Tensor) -> None:
        """Replace tensors by their means over all ranks, in place."""

    def summed(self, values: dict[str, float]) -> dict[str, float]:
        """Return the sums of numbers over all ranks, by name."""
        return values

    def averaged(self, values: dict[str, float]) -> dict[str, float]:
        """Return the means of numbers over all ranks, by name."""
        return values

    def highest(self, *values: int) -> tuple[int, ...]:
        """Return the highest of each number on any rank."""
        return values

    @contextlib.contextmanager
    def failing_together(self) -> Iterator[None]:
        """Raise `FloatingPointError` on every rank after a ``with`` block that raises it on any rank."""
        yield

    def mean_and_deviation(self, values: Tensor) -> tuple[Tensor, Tensor]:
        """Return mean and standard deviation of the values of all ranks, which have equally many."""
        return values.mean(), values.std()

    def check_same(self, networks: nn.Module, last: str) -> None:
        """Raise `FloatingPointError` if the weights and statistics of some rank differ from those of rank 0.

        Args:
            networks: The networks.
            last: The last checkpoint, for the message.
        """

    def pop(self) -> dict[str, float]:
        """Return what joining the ranks has cost since the last call, as metrics."""
        return {}

    @contextlib.contextmanager
    def led(self, state: Callable[[], dict[str, Any]]) -> Iterator[None]:
        """Let rank 0 do in a ``with`` block what only it does; the other ranks wait for it at the end of theirs.

        Args:
            state: Returns the state of this rank, which rank 0 may ask for; see `gather`.
        """
        yield

    def tick(self) -> None:
        """Tell the ranks that wait that rank 0 is still at work; for what takes longer than the timeout."""

    def gather(self) -> dict[str, dict[str, Any]]:
        """Return the states of the other ranks by number, on rank 0 within `led`."""
        return {}

    def begin(self, config: Any, state: Callable[[int], dict[str, Any]]) -> None:
        """Let all ranks prepare a training, and send them its state; for rank 0.

        Args:
            config: The settings of the training, a `TrainConfig`.
            state: Returns the state for a rank.
        """

    def receive_state(self) -> dict[str, Any]:
        """Return the state that rank 0 sends when all ranks are prepared; for the other ranks."""
        return {}

    def check(self) -> None:
        """Raise an error again if a rank was lost."""

    def __deepcopy__(self, memo: dict[int, Any]) -> Ranks:
        """Return itself, because a copy of networks belongs to the same processes."""
        return self


ALONE = Ranks()
"""A single process."""
