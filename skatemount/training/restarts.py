"""Restarts by ``torchrun --max-restarts``: the processes begin again with the same command, and find their run."""

from __future__ import annotations

import contextlib
import os
import socket
from pathlib import Path

from skatemount.runs import atomic
from skatemount.runs.folder import JOB_OF_TORCHRUN, RunFolder, is_run
from skatemount.utils.ranks import launch


def note_job(run: RunFolder) -> None:
    """Write into a run's folder which ``torchrun`` trains it; nothing without one."""
    if (name := _job()) is not None:
        atomic.write_text(run.path / JOB_OF_TORCHRUN, f"{name}\n")


def run_of_this_job(root: Path) -> Path | None:
    """Return the run that these processes trained before ``torchrun`` restarted them; None if there is none.

    Args:
        root: Folder of all runs.
    """
    name = _job()
    if name is None or launch().restarts == 0:
        return None
    for note in sorted(root.glob(f"*/*/{JOB_OF_TORCHRUN}"), key=_age, reverse=True):
        with contextlib.suppress(OSError, UnicodeDecodeError):
            if note.read_text(encoding="utf-8").strip() == name and is_run(note.parent):
                return note.parent
    return None


def _job() -> str | None:
    """Return a name of this job of ``torchrun``, whose process outlives those that it restarts."""
    if (job := launch().job) is None:
        return None
    return f"{job} {socket.gethostname()} {os.getppid()}"


def _age(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0
