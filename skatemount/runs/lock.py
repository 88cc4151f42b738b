"""One process at a time in a run folder."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from skatemount.utils.errors import ConfigError


@contextmanager
def claimed(run: Path) -> Iterator[None]:
    """Keeps every other process from training in a run until the block ends, or the process does.

    Two that wrote checkpoints and metrics in turn would spoil both.

    Args:
        run: The run's folder.

    Raises:
        ConfigError: Another process is at it.
    """
    lock = FileLock(run / ".lock", blocking=False)
    try:
        lock.acquire()
    except Timeout:
        raise ConfigError(
            f"{run}: is being trained by another process; stop that one first, or start from its policy "
            f"with init_from={run}"
        ) from None
    try:
        yield
    finally:
        lock.release()
