"""Read what a page needs to know of a run or a shipped policy."""

from __future__ import annotations

import json
import math
import shlex
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from skatemount.config.versions import upgrade
from skatemount.runs.checkpoint import PolicyCard, read_card
from skatemount.runs.find import find_checkpoint
from skatemount.runs.folder import PARENT_FILE, RunFolder, is_run
from skatemount.runs.metrics import STEP, read_metrics
from skatemount.utils.errors import ConfigError

MAX_TEXT = 200_000
"""Most characters of a difference of the source tree in a page."""


@dataclass
class Stage:
    """One training: a run, or a part of a chain.

    Attributes:
        name: Its stage.
        config: Its settings under today's names.
        table: Its metrics by name, ``[lines]`` each; empty if it logged none.
        folder: Its folder.
    """

    name: str
    config: dict[str, Any]
    table: dict[str, np.ndarray]
    folder: Path

    @property
    def steps(self) -> np.ndarray:
        """Environment steps of each line of the metrics."""
        return self.table.get(STEP, np.zeros(0))

    @property
    def frames(self) -> int:
        """Environment steps trained."""
        return int(self.steps[-1]) if len(self.steps) else 0

    @property
    def seconds(self) -> float:
        """Time that the training took, s; nan if it is not known."""
        known = self.table.get("Perf/elapsed_s", np.zeros(0))
        known = known[np.isfinite(known)]
        return float(known.max()) if len(known) else math.nan

    @property
    def curriculum_png(self) -> Path | None:
        """Picture of its curriculum, if it drew one."""
        path = RunFolder(self.folder).curriculum_png
        return path if path.is_file() else None


@dataclass
class Subject:
    """A run or a policy that a page is about.

    Attributes:
        name: Name for titles: the run's, or the policy's.
        spec: Specification that loads its policy; None if it has none.
        config: Its settings under today's names.
        folder: Its run folder; None for a policy without one.
        stages: Its trainings in order.
        overrides: The settings that its user gave.
        git: Report of the source tree's state.
        environment: Python, machine and versions by name.
        card: Card of its policy, if it has one.
        parent: The policy that it started from, if it noted one.
    """

    name: str
    spec: str | None
    config: dict[str, Any]
    folder: Path | None = None
    stages: list[Stage] = field(default_factory=list)
    overrides: list[str] | None = None
    git: str = ""
    environment: dict[str, str] = field(default_factory=dict)
    card: PolicyCard | None = None
    parent: dict[str, Any] = field(default_factory=dict)

    @property
    def frames(self) -> int:
        """Environment steps of all its trainings, or those on its card."""
        logged = sum(stage.frames for stage in self.stages)
        return logged or (self.card.frames if self.card is not None else 0)

    @property
    def seconds(self) -> float:
        """Time of all its trainings, s; nan if it is not known."""
        if self.stages:
            return float(sum(stage.seconds for stage in self.stages))
        return float(self.card.metrics.get("Perf/elapsed_s", math.nan)) if self.card is not None else math.nan

    @property
    def command(self) -> str | None:
        """Command that trains it again; None if the user's settings are not known."""
        if self.overrides is None:
            return None
        return shlex.join(["python", "-m", "skatemount.train", *self.overrides])

    @property
    def commit(self) -> str | None:
        """Git commit of the code that trained it, if it was a checkout."""
        first = self.git.partition("\n")[0]
        return first.removeprefix("# commit ") if first.startswith("# commit ") else None

    @property
    def difference(self) -> str:
        """Uncommitted changes of the code that trained it, as a patch."""
        lines = [line for line in self.git.splitlines() if not line.startswith("# ")]
        return "\n".join(lines).strip()[:MAX_TEXT]

    def final(self, name: str) -> float | None:
        """Return a metric at the end: its mean over the last tenth of the trainings' last one that logged it."""
        for stage in reversed(self.stages):
            if (values := stage.table.get(name)) is not None and np.isfinite(values).any():
                return last_mean(values)
        value = self.card.metrics.get(name) if self.card is not None and not self.stages else None
        return float(value) if isinstance(value, int | float) and math.isfinite(value) else None


def last_mean(values: np.ndarray, share: float = 0.1) -> float:
    """Return the mean of the last values that are finite.

    Args:
        values: ``[n]``, at least one of them finite.
        share: Part of the finite values that counts, at least one.
    """
    known = values[np.isfinite(values)]
    return float(known[-max(1, round(share * len(known))) :].mean())


def find_subject(spec: str, root: Path | str, setting: str = "run") -> Subject:
    """Find and read a run or a policy.

    Args:
        spec: As for `skatemount.runs.find.find_checkpoint`; a run without a checkpoint is found as well.
        root: Folder of all runs.
        setting: Name of the setting, for messages.

    Raises:
        ConfigError: There is no such run or policy, or its files are damaged.
    """
    for path in (Path(spec), Path(root) / spec):
        if is_run(path):
            return read_run(RunFolder.open(path, setting))
    found = find_checkpoint(spec, root, setting)
    try:
        run = RunFolder.open(found if found.is_dir() else found.parent, setting)
    except ConfigError:
        return read_policy(found)
    return read_run(run if run.parent is None or not run.parent.parts else run.parent, found)


def read_run(run: RunFolder, checkpoint: Path | None = None) -> Subject:
    """Read a run.

    Args:
        run: Its folder.
        checkpoint: The checkpoint that is meant; None for the latest.
    """
    checkpoint = checkpoint or run.latest
    parts = run.parts or [run]
    stages = [_stage(part) for part in parts]
    card = None if checkpoint is None else read_card(checkpoint)
    return Subject(
        name=run.path.resolve().name,
        spec=None if checkpoint is None else str(checkpoint),
        config=_today(run.config, run.path),
        folder=run.path,
        stages=stages,
        overrides=_overrides(run.path),
        git=_text(run.path / "git.diff"),
        environment=_environment(run.path),
        card=card,
        parent=_json(parts[0].path / PARENT_FILE) or _json(run.path / PARENT_FILE),
    )


def read_policy(path: Path) -> Subject:
    """Read a policy that has no run: what its card says is all there is."""
    from skatemount.runs.shipped import POLICIES, PRETRAINED

    card = read_card(path)
    spec = f"{PRETRAINED}{path.stem}" if path.parent == POLICIES else str(path)
    return Subject(
        name=spec if path.parent == POLICIES else path.stem,
        spec=spec,
        config=_today(card.config, path),
        environment={str(name): str(version) for name, version in card.versions.items()},
        card=card,
    )


def joined(subject: Subject) -> tuple[Stage, list[tuple[float, str]]] | None:
    """Return the metrics of a run's trainings as one, with steps that count on, and where each of them starts.

    Args:
        subject: The run.

    Returns:
        The metrics, and first step and name of each training; None without any metrics.
    """
    stages = [stage for stage in subject.stages if stage.table]
    if not stages:
        return None
    names = dict.fromkeys(name for stage in stages for name in stage.table)
    table = {
        name: np.concatenate([stage.table.get(name, np.full(len(stage.steps), np.nan)) for stage in stages])
        for name in names
    }
    before = np.cumsum([0.0, *(stage.frames for stage in stages[:-1])])
    table[STEP] = np.concatenate([stage.steps + start for stage, start in zip(stages, before)])
    last = stages[-1]
    return Stage(last.name, last.config, table, last.folder), list(
        zip(before.tolist(), [stage.name for stage in stages])
    )


def flat(values: Any, prefix: str = "") -> dict[str, Any]:
    """Return nested settings by their dotted keys; lists and empty groups are values."""
    if not isinstance(values, dict) or not values:
        return {prefix: values} if prefix else {}
    found: dict[str, Any] = {}
    for name, value in values.items():
        found |= flat(value, f"{prefix}.{name}" if prefix else str(name))
    return found


def _stage(run: RunFolder) -> Stage:
    config = _today(run.config, run.path)
    path = run.metrics_file
    table = read_metrics(path) if path.is_file() else {}
    about = config.get("stage")
    name = about.get("name") if isinstance(about, dict) else None
    return Stage(name or run.path.name, config, table if len(table.get(STEP, ())) else {}, run.path)


def _today(config: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return saved settings under today's names; they are only shown, so they are not checked further."""
    try:
        return upgrade(config)
    except ConfigError as error:
        raise ConfigError(f"{path}: saved settings: {error}") from error


def _overrides(folder: Path) -> list[str] | None:
    path = folder / "overrides.yaml"
    if not path.is_file():
        return None
    import yaml

    try:
        found = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not plain YAML ({' '.join(str(error).split())[:200]})") from error
    return [str(each) for each in found or []] if isinstance(found, list | None) else None


def _environment(folder: Path) -> dict[str, str]:
    lines = _text(folder / "environment.txt").splitlines()
    return {name: value.strip() for name, colon, value in (line.partition(":") for line in lines) if colon}


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def _json(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_bytes())
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}
