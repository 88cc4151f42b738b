"""Locks of runs, as other processes see them."""

from __future__ import annotations

from pathlib import Path

from filelock import FileLock, Timeout

LOCK_FILE = ".lock"
"""Name of the lock in the folder of a run or a sweep."""


def is_locked(run: Path) -> bool:
    """Return whether another process trains in a run, as far as the file system's locks tell."""
    lock = FileLock(run / LOCK_FILE, blocking=False)
    try:
        lock.acquire()
    except Timeout:
        return True
    except (NotImplementedError, OSError):
        return False
    lock.release()
    return False
