"""Folder of a search: the runs of its trials, its journal, and the signs of life of those that are running.

A search is `<root>/<experiment>/<name>_<hash of the command>/`, so that the same command finds it on every machine
that shares the folder. `sweep.json` marks it and keeps the command line. `journal.log` is Optuna's, `trials/` has the
sign of life of each trial that is running, and `jobs/` a record of each one that ended.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import secrets
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from filelock import FileLock, Timeout

from skatemount.config.search import Dimension
from skatemount.runs import atomic
from skatemount.runs.sweep import FORMAT, SEARCH, SWEEP_FILE, Job, SweepFolder, identity, key_of
from skatemount.utils.errors import ConfigError

JOURNAL = "journal.log"

PLACE = ("logger.root", "logger.experiment", "logger.name")
"""Settings that say where the folder is, which another machine may call differently."""

LONGEST = 600.0
"""Time that a process waits for the others to claim a trial or to write results, s."""

_FREE = ("search.trials", "search.stale_after", *PLACE)
"""Settings that may be others in the next start."""


@dataclass
class TrialJob(Job):
    """A trial of a search as a job, whose run is named after its number."""

    @property
    def label(self) -> str:
        """Name of its folder."""
        return f"trial_{self.number:03d}"

    def describe(self) -> str:
        """Return a line such as ``trial 3 of 20: algorithm.target_kl=0.0113``."""
        settings = " ".join(f"{key}={value}" for key, value in self.settings.items())
        return f"trial {self.number} of {self.sweep.total}: {settings}"


class SearchFolder(SweepFolder):
    """The folder of a search; its jobs are the trials."""

    def trial(self, number: int, overrides: Sequence[str], settings: dict[str, str]) -> TrialJob:
        """Return a trial as a job.

        Args:
            number: Its number, from 1.
            overrides: All overrides of its training, in Hydra's form.
            settings: Its values as text by the setting's key.
        """
        return TrialJob(self, number, list(overrides), settings)

    @contextlib.contextmanager
    def alone(self) -> Iterator[None]:
        """Keep the other processes from claiming a trial, or writing results, in a short ``with`` block."""
        lock = FileLock(self.path / ".claims.lock", timeout=LONGEST)
        try:
            lock.acquire()
        except Timeout:
            raise OSError(None, f"another process has held this lock for {LONGEST:.0f} s", lock.lock_file) from None
        except (NotImplementedError, OSError) as error:
            print(f"warning: {self.path} cannot be locked ({error}); start one search in it at a time", file=sys.stderr)
        try:
            yield
        finally:
            lock.release()

    def sign(self, number: int) -> SignOfLife:
        """Return the sign of life of a trial.

        Args:
            number: Its number, from 1.
        """
        return SignOfLife(self.path / "trials" / f"trial_{number:03d}.json")


def open_folder(root: Path, name: str, overrides: Sequence[str], dimensions: Sequence[Dimension]) -> SearchFolder:
    """Open the folder of a search, which an earlier or another start of the same command may have made.

    Args:
        root: Folder for it.
        name: Beginning of its name.
        overrides: The command line, in Hydra's form.
        dimensions: The space.

    Raises:
        ConfigError: A file that the command names has another space than at the first start.
    """
    command = [each for each in identity(overrides) if key_of(each) not in _FREE]
    digest = hashlib.sha256(json.dumps(command).encode()).hexdigest()[:8]
    path = root / f"{name}_{digest}"
    space = {each.key: each.written for each in dimensions}
    folder = SearchFolder(path, SEARCH, frozenset(map(key_of, command)))
    path.mkdir(parents=True, exist_ok=True)
    with folder.alone():
        file = path / SWEEP_FILE
        if not file.exists():
            document = {"format": FORMAT, "program": SEARCH, "command": list(overrides), "space": space}
            atomic.write_text(file, json.dumps(document, indent=2) + "\n")
            return folder
        folder.is_old = True
        known = json.loads(file.read_bytes())["space"]
    changed = sorted(key for key in {*known, *space} if known.get(key) != space.get(key))
    if changed:
        key = changed[0]
        raise ConfigError(
            f"search.space.{key}={space.get(key, 'null')}: {path} was begun with {known.get(key, 'null')}; "
            "logger.experiment=<another> starts afresh"
        )
    return folder


class SignOfLife:
    """A file that the process of a running trial touches again and again.

    Args:
        path: The file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._token = secrets.token_hex(8)
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None

    def is_fresh(self, stale_after: float) -> bool:
        """Return whether a process works on the trial, as far as its file tells.

        That of a process of this machine that has ended is not fresh, however new it is.

        Args:
            stale_after: Age from which the file counts no longer, s.
        """
        try:
            owner = json.loads(self.path.read_bytes())
            touched = self.path.stat().st_mtime
        except (OSError, ValueError):
            return False
        if owner["machine"] == atomic.machine() and not atomic.is_alive(int(owner["process"])):
            return False
        return self._now() - touched < stale_after

    def take(self) -> None:
        """Claim the trial for this process."""
        owner = {"machine": atomic.machine(), "process": os.getpid(), "token": self._token}
        atomic.write_text(self.path, json.dumps(owner) + "\n")

    @property
    def is_mine(self) -> bool:
        """True unless another process has taken the trial over."""
        try:
            return bool(json.loads(self.path.read_bytes())["token"] == self._token)
        except (OSError, ValueError):
            return False

    @contextlib.contextmanager
    def kept(self, stale_after: float) -> Iterator[None]:
        """Touch the file again and again in a ``with`` block, and delete it at the end.

        Args:
            stale_after: As for `is_fresh`.
        """
        every = min(stale_after / 6, 20)
        self._ended.clear()
        self._thread = threading.Thread(target=self._touch, args=(every,), name="sign of life", daemon=True)
        self._thread.start()
        try:
            yield
        finally:
            self._ended.set()
            self._thread.join()
            if self.is_mine:
                self.path.unlink(missing_ok=True)

    def _touch(self, every: float) -> None:
        while not self._ended.wait(every):
            with contextlib.suppress(OSError):
                if self.is_mine:
                    os.utime(self.path)

    def _now(self) -> float:
        """Return the time of the file system's clock, which may be that of another machine, s."""
        probe = self.path.with_name(f".clock-{self._token}")
        try:
            probe.touch()
            return probe.stat().st_mtime
        except OSError:
            return time.time()
        finally:
            probe.unlink(missing_ok=True)
