"""Faults right before an operation on files."""

from __future__ import annotations

import errno
import os
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from trials.process import BATCH, FAILURES, Lab, check, forked, frames_of, report, row, train, without_pictures

from skatemount.training.trainer import Trainer


class Operations:
    """Counts the operations on files in a folder, and does something before one of them.

    Args:
        folder: The folder.
        number: The operation, from 1; 0 for none.
        act: The deed.
    """

    def __init__(self, folder: Path, number: int, act: Callable[[], None]) -> None:
        self.count, self.armed = 0, False
        self._folder, self._number, self._act = str(folder), number, act
        sys.addaudithook(self._audit)
        real = os.fsync

        def fsync(descriptor: int) -> None:
            self._operation()
            real(descriptor)

        os.fsync = fsync

    def _audit(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self.armed or event not in ("open", "os.mkdir", "os.rename", "os.remove", "os.rmdir"):
            return
        if event == "open" and not (arguments[2] or 0) & (os.O_WRONLY | os.O_RDWR):
            return
        if self._folder in str(arguments[0]) or event == "os.remove" or event == "os.rmdir":
            self._operation()

    def _operation(self) -> None:
        if not self.armed:
            return
        self.count += 1
        if self.count == self._number:
            self._act()


def saving(run: Path, root: Path, number: int, act: Callable[[], None], counted: Path | None = None) -> None:
    """Resume a run for two iterations, with something done before a file operation of the first one's saving."""
    operations = Operations(root, number, act)
    real = Trainer.save

    def save(trainer: Trainer, metrics: dict[str, float]) -> None:
        operations.armed = True
        try:
            real(trainer, metrics)
        finally:
            operations.armed = False
        if counted is not None:
            counted.write_text(str(operations.count))
            os._exit(0)

    Trainer.save = save  # type: ignore[method-assign]
    without_pictures()
    train(f"resume={run}", f"total_frames={frames_of(run) + 2 * BATCH}")


def every_operation(lab: Lab, act: Callable[[], None], what: str) -> Iterator[tuple[int, int, Path]]:
    """Yield number, exit status and run, with the deed done before each file operation of a saving iteration in turn.

    Args:
        lab: The folder for trials.
        act: The deed.
        what: The fault, for the progress.
    """
    base = lab.new("total_frames=256", "logger.keep_checkpoints=2")
    kept, counted = lab.folder / "kept", lab.folder / "count.txt"
    shutil.rmtree(kept, ignore_errors=True)
    shutil.copytree(base, kept)
    forked(lambda: saving(base, lab.folder, 0, act, counted), lab.log)
    total = int(counted.read_text())
    numbers = list(range(1, total + 1))
    if lab.times is not None and lab.times < total:
        numbers = sorted(lab.random.sample(numbers, lab.times))
    for number in numbers:
        shutil.rmtree(base)
        shutil.copytree(kept, base)
        yield number, forked(lambda number=number: saving(base, lab.folder, number, act), lab.log), base
        if number % 10 == 0:
            report(f"{what}: operation {number} of {total}")


def operations(lab: Lab) -> dict[str, Any]:
    """Kill a training right before each file operation of a saving iteration."""
    lost = []
    for number, status, run in every_operation(lab, lambda: os.kill(os.getpid(), signal.SIGKILL), "operations"):
        if status != -signal.SIGKILL:
            FAILURES.append(f"operation {number}: ended with {status}")
        lost.append(check(run, lab.log, f"kill before operation {number}"))
    return row("SIGKILL right before each file operation of a save", len(lost), lost, "the iteration that was saved")


def full(lab: Lab) -> dict[str, Any]:
    """Let each file operation of a saving iteration fail, as on a full disk."""
    lost, unnamed = [], 0

    def refuse() -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    for number, status, run in every_operation(lab, refuse, "full disk"):
        said = lab.log.read_text()
        if status == 2:
            named = "No space left on device; free some space there; " in said and "go on with: " in said
            if not named or str(run) not in said.rpartition("skatemount.train: ")[2]:
                FAILURES.append(f"full disk at operation {number}: {said[-400:]}")
        elif status == 0:
            unnamed += 1  # what cannot be deleted, or flushed where a flush is a courtesy, ends nothing
        else:
            FAILURES.append(f"full disk at operation {number}: ended with {status}: {said[-400:]}")
        lost.append(check(run, lab.log, f"full disk at operation {number}"))
    found = row("disk full at each file operation of a save", len(lost), lost, "the iteration that was saved")
    return found | {"went_on": unnamed}
