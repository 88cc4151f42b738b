"""Run folders: where a training puts what it makes, and how to find it again.

A run is `<root>/<experiment>/<YYYY-MM-DD_HH-MM-SS>_<name>/`. In it, `latest` and `best` are text
files whose first line names a checkpoint folder relative to the run; `<root>/latest` names the
newest run that has a checkpoint, relative to the root. They are files and not links so that they
survive copying and work on every system.

A run may consist of parts, each a run folder in it (`1_gait`, `2_balance`, …): its `latest` and
`best` are those of the part that was written last.
"""

from __future__ import annotations

import datetime
import itertools
import math
import re
from pathlib import Path
from typing import Any

import yaml

from skatemount.runs import atomic
from skatemount.runs.checkpoint import is_checkpoint, list_checkpoints, step_folder
from skatemount.runs.provenance import environment_report, git_report
from skatemount.utils.errors import ConfigError

POINTERS = ("latest", "best")

_NAME = re.compile(r"[\w][\w.,=+-]*")
_PART = re.compile(r"(\d+)_.+")
_RUN_NAME = re.compile(r"\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d_.+")


class RunFolder:
    """One training's folder.

    Attributes:
        path: The folder.
        parent: The run that this one is a part of, if it is one.
    """

    def __init__(self, path: Path, root: Path | None = None, parent: RunFolder | None = None) -> None:
        """Wraps a folder that exists; use `create`, `create_part` or `open`."""
        self.path = path
        self.parent = parent
        self._root = root

    @classmethod
    def create(cls, root: Path | str, experiment: str, name: str, config: dict, overrides: list[str]) -> RunFolder:
        """Makes a new run folder and notes what is run, with which code and on what.

        Args:
            root: Folder of all runs, usually `runs`.
            experiment: Name of the group of runs, one path component.
            name: Name of this run, appended to the time; one path component.
            config: The full resolved configuration as plain data.
            overrides: What was given on the command line.

        Returns:
            The run; its folder is new even if another run starts in the same second.

        Raises:
            ConfigError: A name is not a plain one, or the configuration is not plain data.
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

    def create_part(self, name: str, config: dict, overrides: list[str]) -> RunFolder:
        """Makes a run that is a part of this one.

        Args:
            name: Of its folder in this one.
            config: As for `create`.
            overrides: As for `create`.

        Raises:
            ConfigError: As for `create`, or there is such a part already.
        """
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
        """Opens an existing run, to resume it or to read it.

        Args:
            path: The run folder, or a checkpoint folder in it.
            setting: What to call it in messages.

        Raises:
            ConfigError: It is not a run.
        """
        path = Path(path)
        for folder in (path, path.parent.parent if path.parent.name == "checkpoints" else path):
            if is_run(folder):
                return cls(folder, parent=cls(folder.parent) if is_run(folder.parent) else None)
        raise ConfigError(
            f"{setting}={str(path)!r}: not a run folder (config.yaml and git.diff in it), nor a checkpoint of one"
        )

    @property
    def config(self) -> dict[str, Any]:
        """The configuration it was started with.

        Raises:
            ConfigError: `config.yaml` is damaged.
        """
        path = self.path / "config.yaml"
        try:
            config = yaml.safe_load(path.read_text(encoding="utf-8"))
        except (yaml.YAMLError, UnicodeDecodeError) as error:
            raise ConfigError(f"{path}: not plain YAML ({' '.join(str(error).split())})") from error
        if not isinstance(config, dict):
            raise ConfigError(f"{path}: holds a {type(config).__name__}, a mapping is needed")
        return config

    @property
    def checkpoints(self) -> Path:
        """Folder of the checkpoints, made when first asked for; so is the next one."""
        return self._folder("checkpoints")

    @property
    def videos(self) -> Path:
        """Folder of the films."""
        return self._folder("videos")

    @property
    def metrics_csv(self) -> Path:
        """The metrics' table (a file, made by `skatemount.runs.loggers.MetricsLog`)."""
        return self.path / "metrics.csv"

    @property
    def curves_png(self) -> Path:
        """The picture of the learning curves."""
        return self.path / "curves.png"

    @property
    def curriculum_png(self) -> Path:
        """The picture of the curriculum."""
        return self.path / "curriculum.png"

    @property
    def parts(self) -> list[RunFolder]:
        """The runs that this one consists of, in order; none if it is a single training."""
        numbered = ((_PART.fullmatch(p.name), p) for p in self.path.iterdir() if is_run(p))
        ordered = sorted((int(number[1]), p) for number, p in numbered if number)
        return [RunFolder(path, parent=self) for _, path in ordered]

    @property
    def latest(self) -> Path | None:
        """The checkpoint marked last, or the newest there is if that one is gone."""
        marked = follow(self.path / "latest")
        if marked is not None and is_checkpoint(marked):
            return marked
        return next(reversed(list_checkpoints(self.path / "checkpoints")), None)

    @property
    def best(self) -> Path | None:
        """The checkpoint with the highest score, if any had one."""
        marked = follow(self.path / "best")
        return marked if marked is not None and is_checkpoint(marked) else None

    def checkpoint(self, frames: int) -> Path:
        """Returns where the checkpoint after `frames` environment steps belongs."""
        return self.checkpoints / step_folder(frames)

    def mark_checkpoint(self, folder: Path, score: float | None) -> None:
        """Points `latest` at a checkpoint, and `best` too if no score was higher so far.

        At equal scores the later checkpoint is the best: it has trained longer.

        Args:
            folder: A checkpoint folder of this run.
            score: Higher is better; None or not a number if it was not evaluated.

        Raises:
            ConfigError: The folder is not a checkpoint of this run.
        """
        folder = Path(folder)
        inside = folder.resolve().is_relative_to(self.path.resolve())
        if not inside or not is_checkpoint(folder):
            raise ConfigError(f"{folder}: not a checkpoint of the run {self.path}")
        target = folder.resolve().relative_to(self.path.resolve()).as_posix()
        atomic.write_text(self.path / "latest", f"{target}\n")
        if score is not None and not math.isnan(score) and score >= self._best_score():
            atomic.write_text(self.path / "best", f"{target}\nscore {float(score)!r}\n")
        self._mark_run()

    def _mark_run(self) -> None:
        if self.parent is not None:
            self.parent._follow_part(self)
            return
        root = self.path.absolute().parent.parent
        # A run that was opened may have been moved anywhere: there, no pointer is strewn about.
        if self._root is None and not (root / "latest").is_file():
            return
        newest = follow(root / "latest")
        if newest is None or age_key(self.path) >= age_key(newest):
            relative = self.path.absolute().relative_to(root).as_posix()
            atomic.write_text(root / "latest", f"{relative}\n")

    def _follow_part(self, part: RunFolder) -> None:
        """Points `latest` and `best` at those of a part."""
        for name in POINTERS:
            try:
                pointer = (part.path / name).read_text(encoding="utf-8")
            except FileNotFoundError:
                # Not the best of another part: their scores are for different tasks.
                (self.path / name).unlink(missing_ok=True)
                continue
            atomic.write_text(self.path / name, f"{part.path.name}/{pointer}")
        self._mark_run()

    def _best_score(self) -> float:
        if self.best is None:
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


def _check_name(setting: str, value: str) -> None:
    if not _NAME.fullmatch(value):
        raise ConfigError(f"{setting}={value!r}: letters, digits and . , = + - _ make a folder name")


def _yaml(config: dict) -> str:
    try:
        return yaml.safe_dump(config, sort_keys=False, allow_unicode=True)
    except yaml.YAMLError as error:
        reason = " ".join(str(error).split())
        raise ConfigError(f"config: not plain data, needed for YAML ({reason})") from error


def _note(path: Path, config_text: str, overrides: list[str]) -> None:
    """Writes down what is run, with which code and on what."""
    atomic.write_text(path / "overrides.yaml", yaml.safe_dump(list(overrides)))
    atomic.write_text(path / "git.diff", git_report())
    atomic.write_text(path / "environment.txt", environment_report())
    atomic.write_text(path / "config.yaml", config_text)  # last: it marks a complete run


def is_run(path: Path) -> bool:
    """Return whether a folder is a run."""
    # Two files, because a folder of settings has a config.yaml as well.
    return (path / "config.yaml").is_file() and (path / "git.diff").is_file()


def age_key(run: Path) -> tuple[str, str]:
    """Sorts runs by the time in their names, then by the names; renamed ones are the oldest."""
    return ("", run.name) if _RUN_NAME.fullmatch(run.name) is None else (run.name[:19], run.name)


def follow(pointer: Path) -> Path | None:
    """Returns what a pointer file names, if the file and the folder exist."""
    try:
        target = pointer.read_text(encoding="utf-8").partition("\n")[0].strip()
    except (OSError, UnicodeDecodeError):
        return None
    folder = pointer.parent / target
    return folder if target and folder.is_dir() else None
