"""Sweep folders: the runs of one multirun (`-m`), and a record of each of its jobs.

A sweep is `<root>/<experiment>/<YYYY-MM-DD_HH-MM-SS>_<name>/`. `sweep.json` marks it and keeps the command line.
`jobs/` has a record of each job that ended, and `results.json` the table of all of them. The run of a job is a folder
in it, named after the settings that differ: `learning_rate=3e-4,seed=1`.
"""

from __future__ import annotations

import contextlib
import datetime
import hashlib
import itertools
import json
import math
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml
from filelock import FileLock, Timeout
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import QuotedString

from skatemount.runs import atomic
from skatemount.runs.locks import LOCK_FILE
from skatemount.utils.errors import ConfigError

if TYPE_CHECKING:
    from skatemount.runs.folder import RunFolder

SEARCH = "search"
"""The program whose sweeps have no ``-m``: it chooses the settings of its jobs itself."""

SWEEP_FILE = "sweep.json"
JOB_FILE = "job.json"
RESULTS_FILE = "results.json"
FORMAT = 1

MAX_LABEL = 120
"""Bytes of a job's folder name; file systems allow 255, and more is added to the name."""

MACHINE = ("torch_threads", "physics.threads")
"""Settings that do not change what is trained."""

_UNFIT = re.compile(r"[/\x00-\x1f\x7f]")
_SCRATCH = {SWEEP_FILE, "multirun.yaml", LOCK_FILE}


class Score(float):
    """Success rate of a policy, with the counts behind it; not a number if nothing was evaluated.

    Attributes:
        successes: Episodes that succeeded.
        episodes: Episodes evaluated.
        frames: Environment steps that the policy was trained for.
        folder: Folder of its run.
    """

    successes: int = 0
    episodes: int = 0
    frames: int | None = None
    folder: str | None = None

    @classmethod
    def of(cls, successes: int, episodes: int, frames: int | None = None, folder: Path | str | None = None) -> Score:
        """Return the score of an evaluation; the arguments are the attributes."""
        score = cls(successes / episodes if episodes else math.nan)
        score.successes, score.episodes = successes, episodes
        score.frames, score.folder = frames, None if folder is None else str(folder)
        return score


@dataclass
class SweepFolder:
    """The folder of a multirun. It can be sent to another process.

    Attributes:
        path: The folder.
        program: Name of the program.
        fixed: Keys of the settings that all jobs share.
        total: Number of jobs; None if the sweeper decides it while it runs.
        config_dir: The user's own folder of settings, if any.
        pinned: Policies that ``latest`` and ``best`` mean in all jobs, although jobs before them have newer ones.
        is_old: The same command began it earlier.
    """

    path: Path
    program: str
    fixed: frozenset[str] = frozenset()
    total: int | None = None
    config_dir: str | None = None
    pinned: dict[str, str] = field(default_factory=dict)
    is_old: bool = False

    def job(self, number: int, overrides: Sequence[str]) -> Job:
        """Return one of the jobs.

        Args:
            number: Its number, from 1.
            overrides: Its overrides in Hydra's form.
        """
        differ = [each for each in overrides if key_of(each) not in self.fixed]
        return Job(self, number, list(overrides), {key_of(each): _value(each) for each in differ})

    def pin(self, policies: Mapping[str, str]) -> None:
        """Keep the policies that pointers mean, unless an earlier start has kept them.

        Args:
            policies: Checkpoint folders by pointer.
        """
        path = self.path / SWEEP_FILE
        document = json.loads(path.read_bytes())
        self.pinned = dict(policies) | document.get("pinned", {})
        atomic.write_text(path, json.dumps(document | {"pinned": self.pinned}, indent=2) + "\n")

    def pin_policies(self, settings: Sequence[str]) -> None:
        """Let a setting such as ``init_from=latest`` mean the same policy in all jobs, not the run of the job before.

        Args:
            settings: Settings of the command line in Hydra's form.
        """
        named: dict[str, str] = {}
        for each in settings:
            if (key := key_of(each)) in ("init_from", "algorithm.teacher"):
                named |= {value: key for value in each.partition("=")[2].split(",") if value in ("latest", "best")}
        if not named:
            return
        from skatemount.runs.find import find_checkpoint  # imports torch

        root = self.path.parent.parent
        self.pin({name: str(find_checkpoint(name, root, setting)) for name, setting in named.items()})

    def records(self) -> list[dict[str, Any]]:
        """Return the records of all jobs that ended, in the order of their numbers."""
        found = []
        for file in sorted((self.path / "jobs").glob("*.json")):
            with contextlib.suppress(OSError, ValueError):
                found.append(json.loads(file.read_bytes()))
        return sorted(found, key=lambda record: record["number"])

    def create_part(self, name: str, config: dict[str, Any], overrides: list[str]) -> RunFolder:
        """Create the run of a job; arguments and errors are those of `RunFolder.create`."""
        from skatemount.runs.folder import RunFolder  # imports torch

        started = f"{datetime.datetime.now():%Y-%m-%d_%H-%M-%S.%f}"
        run = RunFolder.create_at(self.path / name, self.path.parent.parent, config, overrides)
        atomic.write_text(run.path / JOB_FILE, json.dumps({"started": started}) + "\n")
        return run


@dataclass
class Job:
    """One combination of a sweep's settings.

    Attributes:
        sweep: The sweep.
        number: Its number, from 1.
        overrides: Its overrides in Hydra's form.
        settings: The settings that differ between the jobs, as text by key.
    """

    sweep: SweepFolder
    number: int
    overrides: list[str]
    settings: dict[str, str] = field(default_factory=dict)

    @property
    def short_settings(self) -> dict[str, str]:
        """The settings that differ by the last part of their keys, where that is unambiguous."""
        last = [key.rpartition(".")[2] for key in self.settings]
        names = [short if last.count(short) == 1 else key for key, short in zip(self.settings, last)]
        return dict(zip(names, self.settings.values()))

    @property
    def label(self) -> str:
        """Name of its folder: the settings that differ."""
        text = ",".join(f"{name}={value}" for name, value in self.short_settings.items()) or "run"
        label = _UNFIT.sub("_", text).encode()[:MAX_LABEL].decode(errors="ignore").lstrip(".")
        # Two jobs must not share a name because of what cannot be in it.
        return label if label == text else f"{label}_{hashlib.sha256(text.encode()).hexdigest()[:8]}"

    def describe(self) -> str:
        """Return a line such as ``job 2 of 4: algorithm.learning_rate=3e-4 seed=1``."""
        place = f"job {self.number}" + (f" of {self.sweep.total}" if self.sweep.total is not None else "")
        return f"{place}: " + (
            " ".join(f"{key}={value}" for key, value in self.settings.items()) or "no settings differ"
        )

    def record(self) -> dict[str, Any] | None:
        """Return what became of the job in an earlier start of the sweep; None if it has not ended."""
        try:
            record = json.loads(self._record_file.read_bytes())
        except (OSError, ValueError):
            return None
        return record if identity(record["overrides"]) == identity(self.overrides) else None

    def write_record(
        self, score: float | None, error: str | None = None, run: Path | None = None, pruned: bool = False
    ) -> None:
        """Keep how the job ended.

        Args:
            score: Its result, a `Score` if it trained or evaluated a policy.
            error: One line about why it failed; None if it did not.
            run: Its run, if `score` does not know it.
            pruned: A search has ended it early.
        """
        folder = run if run is not None else getattr(score, "folder", None)
        if folder is not None and Path(folder).parent == self.sweep.path:
            folder = Path(folder).name
        counted = score if isinstance(score, Score) and score.episodes else None
        record = {
            "format": FORMAT,
            "number": self.number,
            "status": "failed" if error is not None else "pruned" if pruned else "finished",
            "settings": self.settings,
            "success": None if counted is None else float(counted),
            "successes": None if counted is None else counted.successes,
            "episodes": None if counted is None else counted.episodes,
            "steps": getattr(score, "frames", None),
            "run": None if folder is None else str(folder),
            "error": error,
            "overrides": self.overrides,
        }
        atomic.write_text(self._record_file, json.dumps(record, indent=2, allow_nan=False) + "\n")

    def runs(self) -> list[Path]:
        """Return the folders of the job's runs, the newest last; each repetition has its own.

        They are recognized by the overrides that they have saved.
        """
        found = []
        for folder in self._folders():
            if not folder.exists():
                break
            with contextlib.suppress(OSError, yaml.YAMLError):
                saved = yaml.safe_load((folder / "overrides.yaml").read_text(encoding="utf-8"))
                if isinstance(saved, list) and identity(saved) == identity(self.overrides):
                    found.append(folder)
        return found

    def cut_off_run(self) -> Path | None:
        """Return the run that was begun and has not ended, if there is one."""
        newest = next(reversed(self.runs()), None)
        record = self.record()
        return None if newest is None or record is not None and record["run"] == newest.name else newest

    def free_name(self) -> str:
        """Return the name of the job's next run."""
        return next(folder.name for folder in self._folders() if not folder.exists())

    @property
    def _record_file(self) -> Path:
        return self.sweep.path / "jobs" / f"{self.label}.json"

    def _folders(self) -> Iterator[Path]:
        names = itertools.chain([self.label], (f"{self.label}_{n}" for n in itertools.count(2)))
        return (self.sweep.path / name for name in names)


@contextlib.contextmanager
def open_sweep(parent: Path, name: str, program: str, arguments: Sequence[str], repeat: bool) -> Iterator[SweepFolder]:
    """Keep a sweep's folder for the time of a block: that of an earlier start of the same command, or a new one.

    Args:
        parent: Folder for it.
        name: Name of a new one, appended to the time.
        program: Name of the program.
        arguments: The command line, settings in Hydra's form.
        repeat: Always make a new one.
    """
    fixed, total = analyze(arguments)
    lock = None
    if not repeat:
        # The newest first; one that another process works on is left alone.
        for path in sorted(parent.glob(f"*/{SWEEP_FILE}"), key=lambda file: file.parent.name, reverse=True):
            if _command(path, program) == identity(arguments) and (lock := _locked(path.parent)) is not None:
                break
    is_old = lock is not None
    if lock is None:
        lock = _new(parent, name)
    folder = Path(lock.lock_file).parent
    if not is_old:
        document = {"format": FORMAT, "program": program, "command": list(arguments)}
        atomic.write_text(folder / SWEEP_FILE, json.dumps(document, indent=2) + "\n")
    try:
        yield SweepFolder(folder, program, fixed, total, is_old=is_old)
    finally:
        with contextlib.suppress(OSError):
            if {each.name for each in folder.iterdir()} <= _SCRATCH:
                # Nothing was begun, mostly because of a mistake in the settings.
                shutil.rmtree(folder)
        lock.release()


def is_sweep(path: Path) -> bool:
    """Return whether a folder is a sweep."""
    return (path / SWEEP_FILE).is_file()


def analyze(overrides: Sequence[str]) -> tuple[frozenset[str], int | None]:
    """Return the keys whose values all jobs share, and the number of jobs; None if the sweeper decides it.

    Args:
        overrides: Settings of a command line in Hydra's form; others are ignored.
    """
    fixed: set[str] = set()
    counts: dict[str, int | None] = {}
    for override in OverridesParser.create().parse_overrides([each for each in overrides if not each.startswith("--")]):
        key = override.key_or_group
        if override.is_hydra_override():
            if key == "hydra/sweeper" or key.startswith("hydra.sweeper.params"):
                counts[key] = None
        elif not override.is_sweep_override():
            fixed.add(key)
        elif override.is_discrete_sweep() and not override.value_type.name.startswith("GLOB"):  # type: ignore[union-attr]
            counts[key] = len(list(override.sweep_string_iterator()))
        else:
            counts[key] = None
    numbers = list(counts.values())
    return frozenset(fixed), None if None in numbers else math.prod(n for n in numbers if n is not None)


def identity(overrides: Sequence[str]) -> list[str]:
    """Return what of a command line decides about its results, in an order of its own."""

    def counts(override: str) -> bool:
        key = key_of(override)
        if key.startswith(("hydra.", "hydra/")):
            return key.startswith(("hydra.sweeper", "hydra/sweeper"))
        return key not in (*MACHINE, "launcher")

    return sorted(filter(counts, overrides))


def key_of(override: str) -> str:
    """Return the dotted key, or the group, of an override."""
    return override.lstrip("+~").partition("=")[0].partition("@")[0]


def _value(override: str) -> str:
    """Return the value of an override as text, without Hydra's quotes."""
    (parsed,) = OverridesParser.create().parse_overrides([override])
    value = parsed._value
    if isinstance(value, QuotedString):
        return value.text
    if isinstance(value, str):
        return value
    return "" if value is None and "=" not in override else parsed.get_value_element_as_str()


def _command(path: Path, program: str) -> list[str] | None:
    """Return the identity of the command that began a sweep; None if another program did, or the file is damaged."""
    try:
        document = json.loads(path.read_bytes())
        return identity(document["command"]) if document["program"] == program else None
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


def _locked(folder: Path) -> FileLock | None:
    """Return a lock on a sweep; None if another process holds it."""
    lock = FileLock(folder / LOCK_FILE, blocking=False)
    try:
        lock.acquire()
    except Timeout:
        return None
    return lock


def _new(parent: Path, name: str) -> FileLock:
    """Create a sweep's folder, even if another sweep starts in the same second, and return a lock on it."""
    if "/" in name or _UNFIT.search(name):
        raise ConfigError(f"logger.name={name!r} must be one folder's name")
    stem = f"{datetime.datetime.now():%Y-%m-%d_%H-%M-%S}_{name}"
    for suffix in itertools.chain([""], (f"_{n}" for n in itertools.count(2))):
        folder = parent / f"{stem}{suffix}"
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        # A process that looks for an earlier start sees the folder only when its file is written.
        lock = _locked(folder)
        if lock is not None:
            return lock
    raise AssertionError
