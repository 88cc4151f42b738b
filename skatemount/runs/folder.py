"""Run folders: all that a training writes, and the pointers to its latest and best checkpoint.

A run is `<root>/<experiment>/<YYYY-MM-DD_HH-MM-SS>_<name>/`. In it, `latest` and `best` are text files whose first line
names a checkpoint folder relative to the run; `<root>/latest` names the newest run that has a checkpoint, relative to
the root. They are files, not links, so that they survive copying and work on every system.

A run may consist of parts (`1_gait`, `2_balance`, …), each a run folder in it: its latest and best checkpoint are those
of the last part that has one. The runs of a sweep lie one level deeper, see `skatemount.runs.sweep`.
"""

from __future__ import annotations

import contextlib
import datetime
import itertools
import json
import math
import re
import shutil
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml
from filelock import FileLock, Timeout

from skatemount.runs import atomic
from skatemount.runs.checkpoint import is_checkpoint, list_checkpoints, step_folder
from skatemount.runs.locks import LOCK_FILE
from skatemount.runs.metrics import OLD_SUFFIX
from skatemount.runs.provenance import environment_report, git_report
from skatemount.runs.sweep import JOB_FILE, is_sweep
from skatemount.utils.documents import read_yaml
from skatemount.utils.errors import ConfigError

JOB_OF_TORCHRUN = ".torchrun"
"""File of a run that names the job of ``torchrun`` that trains it."""

_AT_START = {"config.yaml", "overrides.yaml", "git.diff", "environment.txt", "parent.json", "stages.yaml",
             "stages.json", JOB_FILE, LOCK_FILE, JOB_OF_TORCHRUN, "wandb.json", "trackio.json"}  # fmt: skip
"""Files that a run has before anything is trained."""

POINTERS = ("latest", "best")
PARENT_FILE = "parent.json"

MAX_NAME = 200
"""Bytes of a run's name; file systems allow 255, and the time is added to it."""

_PART = re.compile(r"(\d+)_.+")
_RUN_NAME = re.compile(r"\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d_.+")


class RunFolder:
    """The folder of one training.

    Attributes:
        path: The folder.
        parent: The run that this one is a part of, if any.
        curves_png: The picture of the learning curves.
        curriculum_png: The picture of the curriculum.
    """

    def __init__(self, path: Path, root: Path | None = None, parent: RunFolder | None = None) -> None:
        """Wrap a folder that exists; use `create`, `create_part` or `open` instead."""
        self.path = path
        self.parent = parent
        self.curves_png = path / "curves.png"
        self.curriculum_png = path / "curriculum.png"
        self._root = root

    @classmethod
    def create(cls, root: Path | str, experiment: str, name: str, config: dict, overrides: list[str]) -> RunFolder:
        """Create a run folder, even if another run starts in the same second.

        Args:
            root: Folder of all runs, usually `runs`.
            experiment: Folder of a group of runs in it.
            name: Name of this run, appended to the time.
            config: The full resolved configuration as plain data.
            overrides: The overrides of the command line.

        Raises:
            ConfigError: A name is not one path component, or the configuration is not plain data.
        """
        _check_name("logger.experiment", experiment)
        _check_name("logger.name", name)
        config_text = _yaml(config)
        parent = Path(root) / experiment
        stem = f"{datetime.datetime.now():%Y-%m-%d_%H-%M-%S}_{name}"
        for suffix in itertools.chain([""], (f"_{n}" for n in itertools.count(2))):
            path = parent / f"{stem}{suffix}"
            try:
                path.mkdir(parents=True)
            except FileExistsError:
                continue
            break
        _note(path, config_text, overrides)
        return cls(path, Path(root))

    @classmethod
    def create_at(cls, path: Path, root: Path, config: dict, overrides: list[str]) -> RunFolder:
        """Create a run in a folder of a given name; arguments and errors are those of `create`."""
        config_text = _yaml(config)
        path.mkdir(parents=True)
        _note(path, config_text, overrides)
        return cls(path, root)

    def create_part(self, name: str, config: dict, overrides: list[str]) -> RunFolder:
        """Create a part of this run, a folder in it; arguments and errors are those of `create`."""
        _check_name("name", name)
        config_text = _yaml(config)
        path = self.path / name
        try:
            path.mkdir()
        except FileExistsError as error:
            raise ConfigError(f"{path}: exists already") from error
        _note(path, config_text, overrides)
        return RunFolder(path, parent=self)

    @classmethod
    def open(cls, path: Path | str, setting: str = "run") -> RunFolder:
        """Open the run of a run folder or of a checkpoint folder; anything else is a `ConfigError` on `setting`."""
        path = Path(path)
        for folder in (path, path.parent.parent if path.parent.name == "checkpoints" else path):
            if is_run(folder):
                return cls(folder, parent=cls(folder.parent) if is_run(folder.parent) else None)
        raise ConfigError(
            f"{setting}={str(path)!r}: not a run folder (config.yaml and git.diff in it), nor a checkpoint of one"
        )

    @classmethod
    def newest(cls, root: Path | str, experiment: str, name: str) -> RunFolder | None:
        """Return the newest run of a name that has a checkpoint, or None if there is none."""
        paths = [path for path in (Path(root) / experiment).glob("*") if _RUN_NAME.fullmatch(path.name)]
        named = sorted((path for path in paths if path.name[20:] == name), key=age_key, reverse=True)
        return next((run for run in map(cls, named) if run.latest is not None), None)

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Keep all other processes from training in this run until the block ends, or the process does.

        Raises:
            ConfigError: Another process holds the lock.
        """
        lock = FileLock(self.path / LOCK_FILE, blocking=False)
        try:
            lock.acquire()
        except Timeout:
            raise ConfigError(
                f"{self.path}: is being trained by another process; stop that one first, or start from its policy "
                f"with init_from={self.path}"
            ) from None
        except (NotImplementedError, OSError) as error:
            # Some network file systems have no locks.
            print(f"warning: {self.path} cannot be locked ({error}); do not train in it twice at once", file=sys.stderr)
        try:
            # Only the holder may: another process would delete what this one is writing.
            self._clear()
            yield
        finally:
            lock.release()

    def _clear(self) -> None:
        """Delete the leftovers of killed processes in the run, and in the folder of all runs."""
        atomic.recover(self.path)
        if (self.path / "checkpoints").is_dir():
            atomic.recover(self.path / "checkpoints")
            for folder in list_checkpoints(self.path / "checkpoints"):
                atomic.clear(folder)
        # The root is one folder higher for a part of a run, or a run of a sweep.
        for folder in self.path.absolute().parents[1:3]:
            atomic.clear(folder, "latest")

    @property
    def config(self) -> dict[str, Any]:
        """The configuration that the run was started with; a damaged `config.yaml` is a `ConfigError`."""
        return read_yaml(self.path / "config.yaml")

    @property
    def checkpoints(self) -> Path:
        """The folder of the checkpoints, created on first use."""
        return self._folder("checkpoints")

    @property
    def videos(self) -> Path:
        """The folder of the films, created on first use."""
        return self._folder("videos")

    @property
    def metrics_file(self) -> Path:
        """The metrics, `metrics.jsonl`; the `metrics.csv` of an older version if that is the only one."""
        path = self.path / "metrics.jsonl"
        old = path.with_suffix(OLD_SUFFIX)
        return old if old.is_file() and not path.is_file() else path

    @property
    def parts(self) -> list[RunFolder]:
        """The runs that this one consists of, in order; none for a single training."""
        numbered = ((_PART.fullmatch(p.name), p) for p in self.path.glob("*") if is_run(p))
        ordered = sorted((int(number[1]), p) for number, p in numbered if number)
        return [RunFolder(path, parent=self) for _, path in ordered]

    @property
    def latest(self) -> Path | None:
        """The checkpoint that was marked last, or the newest one if that is gone; of the last part that has one."""
        if (part := self._last_part()) is not None:
            return part.latest
        newest = next(reversed(list_checkpoints(self.path / "checkpoints")), None)
        return self._marked("latest") or newest

    @property
    def best(self) -> Path | None:
        """The checkpoint with the highest score, if any had one; of the last part that has a checkpoint."""
        part = self._last_part()
        return self._marked("best") if part is None else part.best

    def checkpoint(self, frames: int) -> Path:
        """Return the path of the checkpoint after `frames` environment steps."""
        return self.checkpoints / step_folder(frames)

    def mark_checkpoint(self, folder: Path, score: float | None) -> None:
        """Point `latest` at a checkpoint, and `best` as well if no earlier score was higher.

        At equal scores the later checkpoint is the best: it has trained longer.

        Args:
            folder: A checkpoint folder of this run.
            score: Higher is better; None or nan if it was not evaluated.

        Raises:
            ConfigError: The folder is not a checkpoint of this run.
        """
        folder = Path(folder)
        if not folder.resolve().is_relative_to(self.path.resolve()) or not is_checkpoint(folder):
            raise ConfigError(f"{folder}: not a checkpoint of the run {self.path}")
        target = folder.resolve().relative_to(self.path.resolve()).as_posix()
        atomic.write_text(self.path / "latest", f"{target}\n")
        if score is not None and not math.isnan(score) and score >= self._best_score():
            atomic.write_text(self.path / "best", f"{target}\nscore {float(score)!r}\n")
        self._mark_run()

    def remove_unused(self) -> bool:
        """Remove the folder if it has no more than what a training writes when it starts; return whether it did.

        Only for who made the folder, and holds its lock.
        """
        with contextlib.suppress(OSError):
            for path in self.path.rglob("*"):
                inside = path.relative_to(self.path).parts[0]
                if path.is_file() and path.name not in _AT_START and inside != "wandb" and not _is_empty_log(path):
                    return False
            shutil.rmtree(self.path)
            # Folders of a run's group stay if another run is in them.
            self.path.parent.rmdir()
        return not self.path.exists()

    def note_parent(self, parent: Mapping[str, Any]) -> None:
        """Write which policy this run started from to `parent.json`.

        Args:
            parent: Its name, path, frames and the SHA-256 of its weights, as plain values.
        """
        atomic.write_text(self.path / PARENT_FILE, json.dumps(parent, indent=2, ensure_ascii=False) + "\n")

    def _mark_run(self) -> None:
        """Point `<root>/latest` at this run, or the one it is a part of, unless a newer one has a checkpoint."""
        run = self.parent or self
        folder = run.path.absolute().parent
        root = folder.parent.parent if is_sweep(folder) else folder.parent
        # A run that was opened may have been moved to any place, where a pointer beside it would be litter.
        if run._root is None and not (root / "latest").is_file():
            return
        newest = follow(root / "latest")
        if newest is None or age_key(run.path) >= age_key(newest):
            atomic.write_text(root / "latest", f"{run.path.absolute().relative_to(root).as_posix()}\n")

    def _last_part(self) -> RunFolder | None:
        return next((part for part in reversed(self.parts) if part.latest is not None), None)

    def _marked(self, pointer: str) -> Path | None:
        marked = follow(self.path / pointer)
        return marked if marked is not None and is_checkpoint(marked) else None

    def _best_score(self) -> float:
        if self._marked("best") is None:
            return -math.inf
        _, _, note = (self.path / "best").read_text(encoding="utf-8").partition("\nscore ")
        try:
            return float(note)
        except ValueError:
            return -math.inf

    def _folder(self, name: str) -> Path:
        folder = self.path / name
        folder.mkdir(exist_ok=True)
        return folder


def _is_empty_log(path: Path) -> bool:
    """Return whether a file is one that loggers open before there is anything to log."""
    # An event file of TensorBoard begins with a record of its version.
    return path.stat().st_size == 0 or path.name.startswith("events.out.tfevents.") and path.stat().st_size < 1000


def is_run(path: Path) -> bool:
    """Return whether a folder is a run."""
    # Two files, because a folder of settings has a config.yaml as well.
    return (path / "config.yaml").is_file() and (path / "git.diff").is_file()


def age_key(run: Path) -> tuple[str, str]:
    """Return a sort key: the time in the run's name, then the name; renamed runs are the oldest.

    A run of a sweep has no time in its name but in a file.
    """
    if _RUN_NAME.fullmatch(run.name):
        return run.name[:19], run.name
    try:
        return str(json.loads((run / JOB_FILE).read_bytes())["started"]), run.name
    except (OSError, ValueError, KeyError, TypeError):
        return "", run.name


def follow(pointer: Path) -> Path | None:
    """Return the folder that a pointer file names, if both exist; it never leads out of the pointer's own folder."""
    try:
        target = pointer.read_text(encoding="utf-8").partition("\n")[0].strip()
    except (OSError, UnicodeDecodeError):
        return None
    inside = bool(target) and not Path(target).is_absolute() and ".." not in Path(target).parts
    folder = pointer.parent / target
    return folder if inside and folder.is_dir() else None


def _check_name(setting: str, value: str) -> None:
    fits = 0 < len(value.encode("utf-8", "replace")) <= MAX_NAME and value.isprintable() and value.strip() == value
    if not fits or "/" in value or "\\" in value or value.startswith((".", "-")):
        raise ConfigError(
            f"{setting}={value!r} must be the name of one folder: printable characters without / and \\, at most "
            f"{MAX_NAME} bytes, no dot, hyphen or blank in front, no blank at the end"
        )


def _yaml(config: dict) -> str:
    try:
        return yaml.safe_dump(config, sort_keys=False, allow_unicode=True)
    except yaml.YAMLError as error:
        reason = " ".join(str(error).split())
        raise ConfigError(f"config: not plain data, needed for YAML ({reason})") from error


def _note(path: Path, config_text: str, overrides: list[str]) -> None:
    """Write the settings, the code's version and the machine's description."""
    atomic.write_text(path / "overrides.yaml", yaml.safe_dump(list(overrides)))
    atomic.write_text(path / "git.diff", git_report())
    atomic.write_text(path / "environment.txt", environment_report())
    atomic.write_text(path / "config.yaml", config_text)  # last: it marks a complete run
