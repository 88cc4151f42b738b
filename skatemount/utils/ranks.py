"""The processes that train one policy together: `Ranks`, as the code that learns knows them, and `launch`.

This module imports no torch, as the command line does not.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from skatemount.utils.errors import ConfigError

if TYPE_CHECKING:
    from torch import Tensor, nn


@dataclass(frozen=True)
class Launch:
    """Values that ``torchrun`` gives each process that it starts, by variables of its environment.

    The values of a process that it did not start are those of the only one.

    Attributes:
        rank: Number of this process among all, from 0.
        size: Number of all processes.
        local_rank: Number of this process on its machine, from 0.
        local_size: Number of processes on its machine; None if the environment does not say.
        address: Address of the machine with rank 0; "" if the environment does not say.
        restarts: Number of times that the processes were restarted.
        job: Name of the job, which restarts do not change; None without one.
        numbered: Whether the environment gives this process a rank.
    """

    rank: int
    size: int
    local_rank: int
    local_size: int | None
    address: str
    restarts: int
    job: str | None
    numbered: bool

    @property
    def is_rank(self) -> bool:
        """True if ``torchrun`` started this process as one of several."""
        return self.numbered and bool(self.address) and self.size > 1


def launch() -> Launch:
    """Return what ``torchrun`` told this process.

    Raises:
        ConfigError: A variable is no whole number.
    """
    return Launch(
        rank=_number("RANK", 0),
        size=_number("WORLD_SIZE", 1),
        local_rank=_number("LOCAL_RANK", 0),
        local_size=_number("LOCAL_WORLD_SIZE", None),
        address=os.environ.get("MASTER_ADDR", ""),
        restarts=_number("TORCHELASTIC_RESTART_COUNT", 0),
        job=os.environ.get("TORCHELASTIC_RUN_ID"),
        numbered=bool(os.environ.get("RANK")),
    )


def quiet_torch() -> None:
    """Keep PyTorch's C++ frames about a lost rank from hiding the line that says which; call before it is imported."""
    if os.environ.get("TORCHELASTIC_RUN_ID"):
        os.environ.setdefault("TORCH_CPP_LOG_LEVEL", "ERROR")


def _number(name: str, otherwise: Any) -> Any:
    """Return a variable of the environment as a number, or another value if it is not set."""
    text = os.environ.get(name)
    if not text:
        return otherwise
    try:
        return int(text)
    except ValueError as error:
        raise ConfigError(f"{name}={text} in the environment must be a whole number, as torchrun sets it") from error


class Ranks:
    """The processes that train one policy together. This class stands for a single process, so it changes nothing.

    `skatemount.training.distributed.JoinedRanks` stands for several. Every rank must call these methods in the same
    order, with tensors of the same shapes.

    Attributes:
        rank: Number of this process, from 0.
        size: Number of processes.
        command: The program that starts the processes, with its options; None if each machine needs its own.
    """

    rank: int = 0
    size: int = 1
    command: Sequence[str] | None = ("python",)

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

    def announce_training(self) -> None:
        """Tell the other ranks to train what was begun; without it they only prepare it. For rank 0."""

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
