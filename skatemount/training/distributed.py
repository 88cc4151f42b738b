"""Several processes, or ranks, that train one policy: started by ``torchrun``, one or more on each machine.

    torchrun --nproc-per-node=2 -m skatemount.train stage=balance

Every rank has its own worlds and collects from them. Gradients, statistics of the observations, mean and deviation of
the advantages, the KL, the tallies of the curriculum and the statistics of the episodes are those of all ranks
together, so that all ranks keep the same weights, learning rate and curriculum. Rank 0 decides what is trained: it
finds the run, reads and writes its files, evaluates, draws and prints. The others follow it; see
`skatemount.training.follower`.

Ranks trust each other: whoever can reach their ports can take part in the training.
"""

from __future__ import annotations

import contextlib
import enum
import hashlib
import json
import time
from collections.abc import Callable, Iterator, Sequence
from datetime import timedelta
from typing import Any

import torch
import torch.distributed as dist
from torch import Tensor, nn
from torch.distributed.rendezvous import rendezvous

from skatemount import config as configuration
from skatemount.config import TrainConfig
from skatemount.runs.provenance import code_versions
from skatemount.runs.serialization import from_bytes, to_bytes
from skatemount.runs.sweep import key_of
from skatemount.training.addresses import use_interface_to
from skatemount.training.agreement import difference, flat
from skatemount.training.connection import START_TIMEOUT, Connection, RankLost
from skatemount.utils.devices import choose_device
from skatemount.utils.errors import ConfigError
from skatemount.utils.ranks import ALONE, Ranks, launch


class Word(enum.IntEnum):
    """Word of rank 0 to the ranks that wait for it."""

    BUSY = 0
    SAVE = 1
    GO_ON = 2
    END = 3


class JoinedRanks(Ranks):
    """Several processes that train one policy together, connected by `torch.distributed`.

    Args:
        connection: The connection with the others.

    Attributes:
        bytes: Bytes of all tensors that this rank gave to a reduction so far.
        reductions: Number of reductions so far.
        seconds: Time spent in reductions so far, which includes waiting for slower ranks, s.
    """

    def __init__(self, connection: Connection):
        self.rank, self.size = connection.rank, connection.size
        self.bytes, self.reductions, self.seconds = 0, 0, 0.0
        self._connection = connection
        local = launch().local_size or self.size
        self.command = ("torchrun", f"--nproc-per-node={local}") if local == self.size else None
        self._trainings = 0
        self._spoken = time.monotonic()
        self._waited_for = False

    # --- reductions ---

    def sum(self, *tensors: Tensor) -> None:
        """Replace tensors by their sums over all ranks, in place."""
        self._reduce(tensors)

    def mean(self, *tensors: Tensor) -> None:
        """Replace tensors by their means over all ranks, in place."""
        self._reduce(tensors, self.size)

    @torch.no_grad()
    def _reduce(self, tensors: Sequence[Tensor], divisor: int = 1) -> None:
        kinds = dict.fromkeys((each.dtype, each.device) for each in tensors)
        started = time.perf_counter()
        for kind in kinds:
            # One message for all of them, because each costs the network's latency.
            group = [each for each in tensors if (each.dtype, each.device) == kind]
            flat = torch.cat([each.reshape(-1) for each in group])
            with self._connection.open():
                dist.all_reduce(flat)
            if divisor != 1:
                flat /= divisor
            for each, part in zip(group, flat.split([each.numel() for each in group])):
                each.copy_(part.view_as(each))
            self.bytes += flat.numel() * flat.element_size()
            self.reductions += 1
        self.seconds += time.perf_counter() - started

    def summed(self, values: dict[str, float]) -> dict[str, float]:
        """Return the sums of numbers over all ranks, by name."""
        numbers = torch.tensor(list(values.values()), dtype=torch.float64)
        self.sum(numbers)
        return dict(zip(values, numbers.tolist()))

    def averaged(self, values: dict[str, float]) -> dict[str, float]:
        """Return the means of numbers over all ranks, by name."""
        return {name: value / self.size for name, value in self.summed(values).items()}

    def highest(self, *values: int) -> tuple[int, ...]:
        """Return the highest of each number on any rank."""
        numbers = torch.tensor(values)
        with self._connection.open():
            dist.all_reduce(numbers, dist.ReduceOp.MAX)
        return tuple(numbers.tolist())

    @contextlib.contextmanager
    def failing_together(self) -> Iterator[None]:
        """Raise `FloatingPointError` on every rank after a ``with`` block that raises it on any rank."""
        found: FloatingPointError | None = None
        try:
            yield
        except FloatingPointError as error:
            found = error
        (failed,) = self.highest(0 if found is None else self.rank + 1)
        if found is not None:
            raise found
        if failed:
            raise FloatingPointError(f"something on rank {failed - 1} is not finite; that rank says what")

    def mean_and_deviation(self, values: Tensor) -> tuple[Tensor, Tensor]:
        """Return mean and standard deviation of the values of all ranks, which have equally many."""
        mean = values.mean()
        self.mean(mean)
        squares = (values - mean).square().sum()
        self.sum(squares)
        return mean, (squares / (values.numel() * self.size - 1)).sqrt()

    def check_same(self, networks: nn.Module, last: str) -> None:
        """Compare the weights and statistics of all ranks.

        Args:
            networks: The networks.
            last: The last checkpoint, for the message.

        Raises:
            FloatingPointError: They differ on some rank.
        """
        digest = hashlib.sha256()
        for value in networks.state_dict().values():
            digest.update(value.detach().cpu().contiguous().numpy().tobytes())
        own = torch.frombuffer(bytearray(digest.digest()), dtype=torch.uint8)
        found = [torch.empty_like(own) for _ in range(self.size)]
        with self._connection.open():
            dist.all_gather(found, own)
        if other := [rank for rank, each in enumerate(found) if not torch.equal(each, found[0])]:
            raise FloatingPointError(
                f"the weights of rank {other[0]} differ from those of rank 0: something that the update depends on is "
                f"not shared, such as in an algorithm of your own; the last checkpoint is {last or 'not written yet'}"
            )

    def pop(self) -> dict[str, float]:
        """Return the traffic and the time of the reductions since the last call, as metrics."""
        metrics = {
            "Perf/reductions": float(self.reductions),
            "Perf/reduced_megabytes": self.bytes / 1e6,
            "Perf/reduction_time": self.seconds,
        }
        self.bytes, self.reductions, self.seconds = 0, 0, 0.0
        return metrics

    # --- rank 0 and those that follow it ---

    @contextlib.contextmanager
    def led(self, state: Callable[[], dict[str, Any]]) -> Iterator[None]:
        """Let rank 0 do in a ``with`` block what only it does, while the others wait and answer it at the block's end.

        Args:
            state: Returns the state of this rank, which rank 0 may ask for; see `gather`.
        """
        self._waited_for = self.first
        yield
        if self.first:
            self._tell(Word.GO_ON)
            self._waited_for = False
            return
        while (word := Word(self._connection.broadcast_number())) is not Word.GO_ON:
            if word is Word.SAVE:
                self._connection.send(to_bytes(state()))
            if word is Word.END:
                # Rank 0 says why.
                raise SystemExit(1)

    def tick(self) -> None:
        """Tell the ranks that wait that rank 0 is still at work; for what takes longer than the timeout."""
        if self._waited_for and time.monotonic() - self._spoken > self._connection.timeout / 10:
            self._tell(Word.BUSY)

    def gather(self) -> dict[str, dict[str, Any]]:
        """Return the states of the other ranks by number, on rank 0 within `led`; elsewhere nothing."""
        if not self._waited_for:
            return {}
        self._tell(Word.SAVE)
        return {str(rank): from_bytes(data) for rank, data in self._connection.receive_all().items()}

    def check(self) -> None:
        """Raise `RankLost` again if a rank was lost."""
        self._connection.check()

    def begin(self, config: TrainConfig, state: Callable[[int], dict[str, Any]]) -> None:
        """Let all ranks prepare a training, and send them its state; for rank 0.

        Args:
            config: The settings of the training.
            state: Returns the state for a rank.
        """
        self._trainings += 1
        self._connection.store.set(f"training/{self._trainings}", json.dumps(configuration.to_dict(config)))
        self._connection.meet("prepare the training")
        for rank in range(1, self.size):
            self._connection.send(to_bytes(state(rank)), rank)

    def next_training(self) -> dict[str, Any] | None:
        """Wait until rank 0 begins a training, and return its settings; None if there is no further one.

        Raises:
            SystemExit: Rank 0 has failed, and says why.
        """
        self._trainings += 1
        key = f"training/{self._trainings}"
        while not self._connection.has(key):
            if self._connection.has("end"):
                if self._connection.store.get("end") != b"0":
                    raise SystemExit(1)
                return None
            time.sleep(0.1)
        values: dict[str, Any] = json.loads(self._connection.store.get(key))
        return values

    def announce_training(self) -> None:
        """Tell the other ranks to train what was begun; without it they only prepare it. For rank 0."""
        if self.first:
            self._connection.store.set(f"trains/{self._trainings}", "")

    def trains(self) -> bool:
        """Wait until rank 0 announces the training that it has begun; False if it ends, or begins another, without.

        After a restart in the final evaluation nothing is left to train.
        """
        key, following = f"trains/{self._trainings}", f"training/{self._trainings + 1}"
        while not self._connection.has(key):
            if self._connection.has("end") or self._connection.has(following):
                return False
            time.sleep(0.1)
        return True

    def receive_state(self) -> dict[str, Any]:
        """Return the state that rank 0 sends when all ranks are prepared."""
        self._connection.meet("prepare the training")
        return from_bytes(self._connection.receive())

    def end(self, failed: bool) -> None:
        """Tell the other ranks that the program of rank 0 ends; whatever hinders it is left to them to find out.

        Args:
            failed: It ends with an error.
        """
        with contextlib.suppress(Exception):
            self._connection.store.set("end", str(int(failed)))
            if self._waited_for and not self._connection.is_lost:
                self._tell(Word.END)

    def check_settings(self, config: TrainConfig, overrides: Sequence[str] = ()) -> None:
        """Compare the settings with which the ranks were started, and the versions of what computes.

        Args:
            config: Every setting.
            overrides: The overrides of the command line.

        Raises:
            ConfigError: On rank 0, the first difference, as it is written on the command lines if it is there.
            SystemExit: On the other ranks, if there is any.
        """
        written = {key_of(each): each.partition("=")[2] for each in overrides}
        values = {key: str(value) for key, value in flat(configuration.to_dict(config)).items()}
        own = (written, values, code_versions())
        theirs: list[dict[str, str]] = json.loads(self._connection.broadcast(json.dumps(own).encode()))
        asked, settings, versions = zip(own, theirs)
        # One of two machines may have it without git.
        known = versions[0].keys() & versions[1].keys()
        here, there = ({key: value for key, value in each.items() if key in known} for each in versions)
        message = difference(here, there, self.rank)
        if not message and (message := difference(settings[0], settings[1], self.rank)):
            # A file of a group sets much that nobody has written.
            message = difference(asked[0], asked[1], self.rank) or message
        if message:
            message += "; start all ranks with the same settings and the same versions"
        if not self.first:
            self._connection.send(message.encode())
        messages = [data.decode() for data in self._connection.receive_all().values() if data] if self.first else []
        (differs,) = self.highest(int(bool(messages)))
        if messages:
            raise ConfigError(messages[0])
        if differs:
            raise SystemExit(1)

    def _tell(self, word: Word) -> None:
        self._spoken = time.monotonic()
        self._connection.broadcast_number(int(word))


_current: Ranks = ALONE


def current() -> Ranks:
    """Return the ranks that this process has joined; `ALONE` outside of `joined`."""
    return _current


@contextlib.contextmanager
def joined(config: TrainConfig, overrides: Sequence[str] = ()) -> Iterator[Ranks]:
    """Join the other ranks for a ``with`` block, if ``torchrun`` started this process as one of several.

    Args:
        config: The settings with which this rank was started.
        overrides: The overrides of its command line.

    Raises:
        ConfigError: The ranks were started with different settings, or a machine has fewer GPUs than ranks.
        RankLost: Not all ranks have started.
    """
    global _current
    launched = launch()
    if not launched.is_rank:
        yield ALONE
        return
    on_gpu = _choose_gpu(config)
    use_interface_to(launched.address)
    try:
        store, rank, size = next(iter(rendezvous("env://", timeout=timedelta(seconds=START_TIMEOUT))))
    except RuntimeError as error:
        raise RankLost(f"the ranks cannot be joined: {' '.join(str(error).split())[:200]}") from error
    # The store outlives a restart, and has the addresses of the processes before it.
    store = dist.PrefixStore(f"attempt {launched.restarts}", store)
    timeout = config.distributed.timeout
    connection = Connection(dist.PrefixStore("skatemount", store), rank, size, timeout)
    connection.meet("start")
    ranks = JoinedRanks(connection)
    # Words and states go through gloo also on GPUs.
    backend = "cpu:gloo,cuda:nccl" if on_gpu else "gloo"
    failed = True
    try:
        with connection.open():
            dist.init_process_group(
                backend, store=store, rank=rank, world_size=size, timeout=timedelta(seconds=timeout)
            )
        ranks.check_settings(config, overrides)
        if rank and not launched.local_rank:
            # The only line of a machine that does not have rank 0.
            print(f"rank {rank} of {size} has joined; rank 0 at {launched.address} shows the progress", flush=True)
        _current = ranks
        yield ranks
        failed = False
    finally:
        _current = ALONE
        if ranks.first:
            ranks.end(failed)
        elif failed:
            connection.leave()
        if not failed:
            dist.destroy_process_group()


def _choose_gpu(config: TrainConfig) -> bool:
    """Give each rank of a machine a GPU of its own, and return whether worlds are on GPUs."""
    physics = config.physics
    if physics.engine == "cpu" or physics.device == "cpu" or not torch.cuda.is_available():
        return False
    if physics.device in ("auto", "cuda"):
        local, there = launch().local_rank, torch.cuda.device_count()
        if local >= there:
            raise ConfigError(
                f"physics.device={physics.device}: this machine has {there} GPUs, but more ranks; start one for each "
                f"GPU (--nproc-per-node={there})"
            )
        torch.cuda.set_device(local)
    return choose_device(physics.device).type == "cuda"
