"""Facts about runs for tables: what was trained, what differs, what it took."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from skatemount.config import compose, to_dict
from skatemount.config.files import choices
from skatemount.reports.page import shown
from skatemount.reports.subjects import Subject, flat
from skatemount.runs.folder import RunFolder
from skatemount.runs.sweep import Score
from skatemount.training.score import score_of

NOT_TRAINED = ("format", "logger.", "resume", "init_from_expand", "init_from_other_robot")
"""Settings that say nothing about what was trained."""

_TIME = re.compile(r"^\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d_")


def short_names(names: Sequence[str]) -> list[str]:
    """Return names of runs without the time in front, where they stay different; equal ones get a number."""
    short = [_TIME.sub("", name) or name for name in names]
    found = short if len(set(short)) == len(names) else list(names)
    return [name if found.index(name) == i else f"{name} ({i + 1})" for i, name in enumerate(found)]


def duration(seconds: float) -> str:
    """Return a time in words, such as ``1 h 46 min``; a dash if it is not known."""
    if not math.isfinite(seconds):
        return "–"
    if seconds < 59.5:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02} min"


def rate_text(rate: tuple[float, float, float]) -> str:
    """Return a success rate with its interval."""
    return f"{rate[0]:.1%} ({rate[1]:.1%} to {rate[2]:.1%})"


def final_score(subject: Subject) -> Score | None:
    """Return the success of a run's latest policy with its counts; None if it was never evaluated."""
    if subject.folder is None or subject.card is None:
        return None
    score = score_of(RunFolder(subject.folder))
    return score if score.episodes else None


def last_evaluation(subject: Subject) -> tuple[float, int] | None:
    """Return the success of the last evaluation during the training, and the steps before it."""
    for stage in reversed(subject.stages):
        rates = stage.table.get("Evaluation/success", np.zeros(0))
        if len(known := np.flatnonzero(np.isfinite(rates))):
            return float(rates[known[-1]]), int(stage.steps[known[-1]])
    return None


def default_config(subject: Subject) -> tuple[str, dict[str, Any]]:
    """Return the defaults of this version that a run's settings are compared with, and their name."""
    about = subject.config.get("stage")
    stage = about.get("name") if isinstance(about, dict) else None
    if stage and stage in choices("stage"):
        return f"defaults of stage={stage}", to_dict(compose(stage))
    return "defaults", to_dict(compose())


def differences(ours: Mapping[str, Any], theirs: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Return key and both values of each setting that differs, as text.

    A group that one side lacks altogether, such as a reward term, is one row: a dash stands for it.

    Args:
        ours: Nested settings.
        theirs: Others.
    """
    rows: list[tuple[str, str, str]] = []

    def compare(a: Any, b: Any, key: str) -> None:
        if key.startswith(NOT_TRAINED) or a == b:
            return
        if isinstance(a, dict) and isinstance(b, dict):
            for name in dict.fromkeys([*a, *b]):
                compare(a.get(name, _MISSING), b.get(name, _MISSING), f"{key}.{name}" if key else str(name))
            return
        if _in_words(a) != _in_words(b):
            rows.append((key, _in_words(a), _in_words(b)))

    compare(dict(ours), dict(theirs), "")
    return rows


def _in_words(value: Any) -> str:
    """Return a setting's value, of a group the values that say something."""
    if value is _MISSING:
        return "–"
    if isinstance(value, dict):
        said = [f"{name} {shown(each)}" for name, each in flat(value).items() if each not in (None, {}, [], "")]
        return ", ".join(said) or "{}"
    return shown(value)


_MISSING: Any = object()


def about_rows(subjects: Sequence[Subject]) -> list[tuple[str, list[str]]]:
    """Return what was trained, a row for each fact with a cell for each run."""
    rows: dict[str, list[str]] = {}
    for subject in subjects:
        config = flat(subject.config)
        sizes = _sizes(subject)

        def of(key: str, config: dict[str, Any] = config) -> str:
            return shown(config[key]) if key in config else "–"

        stages = " → ".join(stage.name for stage in subject.stages) or of("stage.name")
        parent = subject.parent.get("init_from")
        facts = {
            "stage": stages,
            "task": of("success"),
            "robot": of("robot.variant"),
            "started from": str(parent or _initial(config)),
            "environment steps": f"{subject.frames:,}" + (f" of {config['total_frames']:,}"
                                                        if isinstance(config.get("total_frames"), int) else ""),
            "worlds × steps of an update": f"{of('physics.num_worlds')} × {of('collector.steps_per_env')}",
            "curriculum": of("curriculum.name") if config.get("curriculum.name") else of("curriculum.kind"),
            "actor": of("network.actor"),
            "observation": sizes,
            "control rate": _control_rate(config),
            "seed": of("seed"),
        }  # fmt: skip
        for name, value in facts.items():
            rows.setdefault(name, []).append(value)
    return list(rows.items())


def compute_rows(subjects: Sequence[Subject]) -> list[tuple[str, list[str]]]:
    """Return what the trainings took and where they ran, a row for each fact with a cell for each run."""
    rows: dict[str, list[str]] = {}
    for subject in subjects:
        config, machine = flat(subject.config), subject.environment
        rates = [stage.table["Perf/total_fps"] for stage in subject.stages if "Perf/total_fps" in stage.table]
        known = np.concatenate(rates) if rates else np.zeros(0)
        known = known[np.isfinite(known)]
        if not len(known) and (rate := subject.final("Perf/total_fps")) is not None:
            known = np.array([rate])
        collecting, learning = (_total(subject, f"Perf/{name}_time") for name in ("collection", "learning"))
        both = collecting + learning
        facts = {
            "time": duration(subject.seconds),
            "environment steps a second": f"{np.median(known):,.0f} (median)" if len(known) else "–",
            "of the time, collecting": f"{collecting / both:.0%}" if both else "–",
            "torch threads": _threads(config.get("torch_threads")),
            "physics threads": _threads(config.get("physics.threads")),
            "engine": shown(config.get("physics.engine")),
            "cores": machine.get("cpu_usable", "–"),
            "platform": machine.get("platform", "–"),
            "Python": machine.get("python", "–").partition(" ")[0],
        }
        for name, value in facts.items():
            rows.setdefault(name, []).append(value)
        versions = {n: v for n, v in machine.items() if n not in _NO_VERSION}
        for name, value in versions.items():
            rows.setdefault(name, ["–"] * (len(rows["time"]) - 1)).append(value)
        for cells in rows.values():
            cells += ["–"] * (len(rows["time"]) - len(cells))
    return list(rows.items())


_NO_VERSION = ("python", "platform", "machine", "cpu_count", "cpu_usable", "OMP_NUM_THREADS", "MUJOCO_GL")


def _total(subject: Subject, name: str) -> float:
    return float(sum(np.nansum(stage.table[name]) for stage in subject.stages if name in stage.table))


def _initial(config: Mapping[str, Any]) -> str:
    """Return the initial policy that settings name."""
    given = config.get("init_from")
    found = config.get("stage.init_from") if given == "stage" else given
    return "scratch" if found is None else str(found)


def _threads(value: Any) -> str:
    return "every core" if value == 0 else shown(value)


def _sizes(subject: Subject) -> str:
    if subject.card is None:
        return "–"
    sizes = {
        key: sum(int(part.get("size", 0)) for part in subject.card.observation if part.get("key") == key)
        for key in ("observation", "privileged")
    }
    more = f", and {sizes['privileged']} that only the critic sees" if sizes["privileged"] else ""
    return f"{sizes['observation']} values{more}"


def _control_rate(config: Mapping[str, Any]) -> str:
    step, substeps = config.get("physics.timestep"), config.get("physics.substeps")
    if not isinstance(step, int | float) or not isinstance(substeps, int):
        return "–"
    return f"{1 / (step * substeps):g} Hz"
