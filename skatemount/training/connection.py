"""The connection between ranks: messages of rank 0 and of single ranks, and who is still there."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Sequence

import torch
import torch.distributed as dist
from torch import Tensor

START_TIMEOUT = 600.0
"""Time for all ranks to start, and to prepare a training, s. The first start on a GPU compiles kernels for minutes."""

REPORT_TIME = 3.0
"""Time in which ranks that lost another one say that they are still there, s."""


AGAIN = "; to go on, start torchrun on every machine again, with resume=<the run on the machine of rank 0>"


class RankLost(ConnectionError):
    """Another rank has ended or does not answer, so the training cannot go on. The message is one line."""


class Connection:
    """The connection of one rank with all others.

    The messages go through the default group of `torch.distributed`, which may be made after this object.

    Args:
        store: Keys and values that all ranks share.
        rank: Number of this process.
        size: Number of processes.
        timeout: Time without an answer after which a rank counts as lost, s; the group must have the same.
    """

    def __init__(self, store: dist.Store, rank: int, size: int, timeout: float):
        self.store = store
        self.rank, self.size, self.timeout = rank, size, timeout
        self._meetings = 0
        self._lost: RankLost | None = None

    # --- messages ---

    def broadcast_number(self, number: int = 0) -> int:
        """Return the number that rank 0 gives."""
        message = torch.tensor([number])
        with self.open():
            dist.broadcast(message, 0)
        return int(message)

    def broadcast(self, data: bytes) -> bytes:
        """Return the data that rank 0 gives."""
        size = self.broadcast_number(len(data))
        buffer = _tensor(data) if self.rank == 0 else torch.empty(size, dtype=torch.uint8)
        with self.open():
            dist.broadcast(buffer, 0)
        return buffer.numpy().tobytes()

    def send(self, data: bytes, rank: int = 0) -> None:
        """Send data to another rank, which must `receive` it."""
        with self.open():
            dist.send(torch.tensor([len(data)]), rank)
            if data:
                dist.send(_tensor(data), rank)

    def receive(self, rank: int = 0) -> bytes:
        """Return the data that another rank sends to this one."""
        size = torch.zeros(1, dtype=torch.int64)
        with self.open():
            dist.recv(size, rank)
            buffer = torch.empty(int(size), dtype=torch.uint8)
            if len(buffer):
                dist.recv(buffer, rank)
        return buffer.numpy().tobytes()

    def receive_all(self) -> dict[int, bytes]:
        """Return what every other rank sends to rank 0, by the number of the rank."""
        return {rank: self.receive(rank) for rank in range(1, self.size)}

    # --- who is there ---

    @property
    def is_lost(self) -> bool:
        """True after a rank was lost."""
        return self._lost is not None

    def check(self) -> None:
        """Raise `RankLost` again if a rank was lost."""
        if self._lost is not None:
            raise self._lost

    @contextlib.contextmanager
    def open(self) -> Iterator[None]:
        """Turn an error of `torch.distributed` in a ``with`` block into `RankLost`, which names the missing rank."""
        self.check()
        try:
            yield
        except RuntimeError:
            raise self._fail(self._who_is_missing()) from None

    def meet(self, what: str) -> None:
        """Wait until all ranks are here; signals end the wait.

        Args:
            what: What they do before, for the message.

        Raises:
            RankLost: One does not come.
        """
        self._meetings += 1
        keys = [f"meeting/{self._meetings}/{rank}" for rank in range(self.size)]
        self.store.set(keys[self.rank], "")
        until = time.monotonic() + START_TIMEOUT
        while not self.has(*keys):
            gone = [rank for rank in range(self.size) if self.has(f"gone/{rank}")]
            if gone or time.monotonic() > until:
                late = [rank for rank, key in enumerate(keys) if not self.has(key)]
                raise self._fail(f"{_named(gone or late)} of {self.size} could not {what}")
            time.sleep(0.05)

    def leave(self) -> None:
        """Tell the ranks that may wait in `meet` that this one ends."""
        with contextlib.suppress(Exception):
            self.store.set(f"gone/{self.rank}", "")

    def has(self, *keys: str) -> bool:
        """Return whether the store has all of some keys."""
        try:
            return self.store.check(list(keys))
        except RuntimeError:
            raise self._fail(f"the torchrun of rank 0 has ended{AGAIN}") from None

    def _fail(self, message: str) -> RankLost:
        self._lost = RankLost(message)
        return self._lost

    def _who_is_missing(self) -> str:
        """Return who does not report in the next seconds; all ranks that are left report at about the same time."""
        missing = [rank for rank in range(self.size) if rank != self.rank]
        with contextlib.suppress(RuntimeError):
            self.store.set(f"there/{self.rank}", "")
            until = time.monotonic() + REPORT_TIME
            while missing and time.monotonic() < until:
                time.sleep(0.1)
                missing = [rank for rank in missing if not self.store.check([f"there/{rank}"])]
        if not missing:
            return f"the connection between the {self.size} ranks broke"
        verb = "have" if len(missing) > 1 else "has"
        return f"{_named(missing)} of {self.size} {verb} ended, or did not answer within {self.timeout:g} s"


def _tensor(data: bytes) -> Tensor:
    return torch.frombuffer(bytearray(data), dtype=torch.uint8)


def _named(ranks: Sequence[int]) -> str:
    return f"rank{'s' if len(ranks) > 1 else ''} {', '.join(map(str, ranks))}"
