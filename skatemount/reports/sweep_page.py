"""The page of a sweep, or of several runs: what differs, means over seeds, curves."""

from __future__ import annotations

import datetime
import json
import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from skatemount.config import ReportConfig
from skatemount.evaluation.intervals import wilson_interval
from skatemount.reports import curves
from skatemount.reports.charts import Chart, Interval, Line, averaged, interval_chart, line_chart
from skatemount.reports.facts import NOT_TRAINED, duration, final_score, last_evaluation, short_names
from skatemount.reports.page import render, shown
from skatemount.reports.statistics import mean_interval
from skatemount.reports.subjects import Stage, Subject, find_subject, flat, joined, read_run
from skatemount.reports.suites import Result, measured_rows, suite_charts, suite_rows
from skatemount.runs.folder import RunFolder, is_run
from skatemount.runs.sweep import MACHINE, SEARCH, SWEEP_FILE, Score, SweepFolder, is_sweep
from skatemount.utils.errors import ConfigError
from skatemount.utils.formatting import format_count

SEED = "seed"

SAME_TRAINING = (*MACHINE, "plugins")
"""Settings that do not change what is trained."""

MAX_COLUMNS = 5
"""Differing settings that the table of runs shows; more stand in a table of their own."""


@dataclass
class Member:
    """A run of a group.

    Attributes:
        name: Its name.
        settings: The settings that differ between the runs, as text.
        subject: The run; None if there is none, such as for a job that failed at once.
        success: Success rate at the end, and the counts behind it; None if it was not evaluated.
        status: ``finished``, ``failed`` or ``not finished``.
        error: One line about why it failed.
    """

    name: str
    settings: dict[str, str]
    subject: Subject | None
    success: Score | None
    status: str
    error: str = ""


@dataclass
class Group:
    """Several runs that are compared.

    Attributes:
        title: Title of the page.
        members: The runs.
        folder: Folder of the sweep; None for single runs.
        command: Command that made the sweep.
        columns: Results of suites, of each run that has some and of other policies by their names.
    """

    title: str
    members: list[Member]
    folder: Path | None = None
    command: str = ""
    columns: dict[str, dict[str, Result]] = field(default_factory=dict)

    @property
    def keys(self) -> list[str]:
        """The settings that differ."""
        return list(dict.fromkeys(key for member in self.members for key in member.settings))

    def sets(self) -> dict[str, list[Member]]:
        """Return the members that differ in the seed alone, by the settings that they share."""
        found: dict[str, list[Member]] = {}
        keys = [key for key in self.keys if key != SEED]
        for member in self.members:
            label = " ".join(f"{_short(key, keys)}={member.settings.get(key, '–')}" for key in keys)
            found.setdefault(label or "all seeds", []).append(member)
        return found


def read_group(config: ReportConfig) -> Group:
    """Read the runs that the settings name.

    Raises:
        ConfigError: There is no such sweep or run.
    """
    root = Path(config.logger.root)
    if config.sweep is None:
        subjects = [find_subject(spec, root, "runs") for spec in config.runs]
        members = [
            Member(name, {}, subject, _success(subject), "finished" if subject.spec else "not finished")
            for name, subject in zip(short_names([each.name for each in subjects]), subjects)
        ]
        _note_differences(members)
        return Group(f"{len(members)} runs", members)
    for path in (Path(config.sweep), root / config.sweep):
        if is_sweep(path):
            return _read_sweep(path)
    there = sorted(str(each.parent) for each in root.glob(f"*/*/{SWEEP_FILE}"))[-3:]
    raise ConfigError(
        f"sweep={config.sweep}: must be the folder of a multirun ({SWEEP_FILE} in it); there are: "
        f"{', '.join(there) or f'none in {root}'}"
    )


def sweep_page(group: Group, command: str) -> str:
    """Return the page.

    Args:
        group: The runs.
        command: Command that writes it.
    """
    sets = group.sets()
    keys = group.keys
    context = {
        "title": group.title,
        "subtitle": f"{len(group.members)} runs, {len(sets)} settings" + (
            f", {sum(member.status == 'failed' for member in group.members)} failed"
            if any(member.status == "failed" for member in group.members) else ""),
        "kind": "sweep" if group.folder is not None else "comparison of runs",
        "made": f"{datetime.datetime.now():%Y-%m-%d %H:%M}",
        "command": command,
        "sweep_command": group.command,
        "tiles": _tiles(group, sets),
        "keys": [_short(key, keys) for key in keys] if len(keys) <= MAX_COLUMNS else [],
        "rows": [_row(member, keys if len(keys) <= MAX_COLUMNS else []) for member in group.members],
        "differences": {"heads": [member.name for member in group.members],
                        "rows": [(key, [member.settings.get(key, "–") for member in group.members]) for key in keys]},
        "sets": [_set_row(name, members) for name, members in sets.items()],
        "set_chart": _set_chart(sets),
        "suites": suite_rows(group.columns),
        "columns": list(group.columns),
        "measured": measured_rows(group.columns),
        "suite_charts": suite_charts(group.columns),
        "charts": _charts(sets),
        "terms": _term_charts(sets),
    }  # fmt: skip
    return render("sweep.html.jinja", context)


def over_seeds(tables: Sequence[Stage], metric: str, label: str, color: int, points: int = 160) -> Line | None:
    """Return the mean of a metric over runs, with a band from the least to the greatest.

    Args:
        tables: The trainings.
        metric: Name of the metric.
        label: Name of the line.
        color: Number of its color.
        points: Most points of the line.

    Returns:
        The line; None if no run logged the metric.
    """
    curves_of = [
        (found[0], found[1])
        for stage in tables
        if metric in stage.table and len((found := averaged(stage.steps, stage.table[metric]))[0])
    ]
    if not curves_of:
        return None
    few = max(len(x) for x, _ in curves_of) <= 40
    if len(curves_of) == 1:
        return Line(label, curves_of[0][0], curves_of[0][1], color, dots=few)
    low = max(float(x[0]) for x, _ in curves_of)
    high = min(float(x[-1]) for x, _ in curves_of)
    places = np.unique(np.concatenate([x for x, _ in curves_of]))
    places = places[(places >= low) & (places <= high)]
    if not len(places):
        return None
    if len(places) > points:
        places = np.linspace(low, high, points)
    values = np.stack([np.interp(places, x, y) for x, y in curves_of])
    return Line(label, places, values.mean(0), color, values.min(0), values.max(0), dots=few)


def _read_sweep(path: Path) -> Group:
    try:
        document = json.loads((path / SWEEP_FILE).read_bytes())
        program, words = str(document["program"]), [str(each) for each in document["command"]]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"sweep={path}: {SWEEP_FILE} is damaged ({error})") from error
    members, seen = [], set()
    for record in SweepFolder(path, program).records():
        folder = path / str(record["run"]) if record.get("run") else None
        subject = read_run(RunFolder(folder)) if folder is not None and is_run(folder) else None
        seen.add(None if folder is None else folder.name)
        success = None
        if record.get("episodes"):
            success = Score.of(int(record["successes"]), int(record["episodes"]), record.get("steps"))
        settings = {str(key): str(value) for key, value in record.get("settings", {}).items()}
        name = str(record.get("run") or f"job {record['number']}")
        members.append(Member(name, settings, subject, success, record["status"], record.get("error") or ""))
    begun = [each for each in sorted(path.iterdir()) if is_run(each) and each.name not in seen]
    for folder in begun:
        subject = read_run(RunFolder(folder))
        members.append(Member(folder.name, {}, subject, _success(subject), "not finished"))
    if begun:
        _note_differences(members)
    if not members:
        raise ConfigError(f"sweep={path}: none of its jobs has begun")
    options = [] if program == SEARCH else ["-m"]
    command = shlex.join(["python", "-m", f"skatemount.{program}", *options, *words])
    return Group(path.resolve().name, members, path, command)


def _note_differences(members: Sequence[Member]) -> None:
    """Note the settings that differ between the runs, of those members that have one."""
    known = [member for member in members if member.subject is not None]
    flats = [flat(member.subject.config) for member in known if member.subject is not None]
    keys = dict.fromkeys(key for each in flats for key in each)
    different = [
        key
        for key in keys
        if not key.startswith(NOT_TRAINED)
        and key not in SAME_TRAINING
        and len({shown(each[key]) if key in each else "–" for each in flats}) > 1
    ]
    for member, values in zip(known, flats):
        member.settings = {key: shown(values[key]) if key in values else "–" for key in different}


def _success(subject: Subject) -> Score | None:
    if (score := final_score(subject)) is not None:
        return score
    last = last_evaluation(subject)
    if last is None:
        return None
    episodes = flat(subject.config).get("logger.evaluate_episodes")
    return Score.of(round(last[0] * episodes), episodes, last[1]) if isinstance(episodes, int) else None


def _rate(member: Member) -> tuple[float, float, float] | None:
    if member.success is None or not member.success.episodes:
        return None
    return float(member.success), *wilson_interval(member.success.successes, member.success.episodes)


def _row(member: Member, keys: Sequence[str]) -> dict[str, Any]:
    subject = member.subject
    speed = subject.final("Perf/total_fps") if subject is not None else None
    return {
        "name": member.name,
        "settings": [member.settings.get(key, "–") for key in keys],
        "rate": _rate(member),
        "episodes": member.success.episodes if member.success is not None else None,
        "steps": "–" if subject is None else format_count(subject.frames),
        "time": "–" if subject is None else duration(subject.seconds),
        "speed": "–" if speed is None else f"{speed:,.0f}",
        "status": member.status,
        "error": member.error,
    }


def success_over_seeds(members: Sequence[Member]) -> tuple[float, float, float] | None:
    """Return the mean success of runs that differ in the seed alone, with its 95 % interval.

    The interval is Student's over the seeds, but never narrower than Wilson's of all their episodes together: runs
    that happen to agree do not make the success known better than their evaluations do.

    Args:
        members: The runs; those that have not finished, or were not evaluated, are left out.
    """
    known = _finished(members)
    found = mean_interval([float(score) for score in known])
    if found is None:
        return None
    low, high = wilson_interval(sum(score.successes for score in known), sum(score.episodes for score in known))
    ends = (low, high) if math.isnan(found[1]) else (min(low, found[1]), max(high, found[2]))
    return found[0], max(0.0, ends[0]), min(1.0, ends[1])


def _finished(members: Sequence[Member]) -> list[Score]:
    found = [member.success for member in members if member.status == "finished"]
    return [score for score in found if score is not None and score.episodes]


def _set_row(name: str, members: Sequence[Member]) -> dict[str, Any]:
    rates = [float(score) for score in _finished(members)]
    found = success_over_seeds(members)
    rewards = [end for m in members if m.subject and (end := m.subject.final("Train/mean_reward")) is not None]
    reward = mean_interval(rewards)
    seconds = [m.subject.seconds for m in members if m.subject and math.isfinite(m.subject.seconds)]
    return {
        "name": name,
        "seeds": f"{len(rates)} of {len(members)}" if len(rates) != len(members) else str(len(members)),
        "rate": found,
        "least": "–" if not rates else f"{min(rates):.1%} to {max(rates):.1%}",
        "reward": "–"
        if reward is None
        else f"{reward[0]:.2f}" + ("" if len(rewards) < 2 else f" ± {reward[2] - reward[0]:.2f}"),
        "time": "–" if not seconds else duration(sum(seconds) / len(seconds)),
    }


def _set_chart(sets: Mapping[str, Sequence[Member]]) -> Chart | None:
    rows = [Interval(name, [success_over_seeds(members)]) for name, members in sets.items()]
    return interval_chart(
        "success at the end", rows, ["mean over seeds"], note="Dots: mean over the seeds; bars: its 95 % interval."
    )


def _tables(sets: Mapping[str, Sequence[Member]]) -> dict[str, list[Stage]]:
    found = {}
    for name, members in sets.items():
        tables = [one[0] for m in members if m.subject is not None and (one := joined(m.subject)) is not None]
        if tables:
            found[name] = tables
    return found


def _charts(sets: Mapping[str, Sequence[Member]]) -> list[Chart]:
    tables = _tables(sets)
    stages = [stage for each in tables.values() for stage in each]
    panels = [*curves.LEARNING, *curves.task_panels(stages), *curves.UPDATES, *curves.SPEED]
    found = []
    for panel in panels:
        order = [panel.of_several, *range(len(panel.metrics))]
        has = [all(panel.metrics[i] in stage.table for stage in stages) for i in range(len(panel.metrics))]
        metric = next((i for i in order if has[i]), order[0])
        lines = [over_seeds(each, panel.metrics[metric], name, i) for i, (name, each) in enumerate(tables.items())]
        title = panel.title if len(panel.metrics) == 1 else f"{panel.title}, {panel.labels[metric]}"
        y_format = curves.percent if panel.percent else None
        chart = line_chart(title, lines, limits=panel.limits, log=panel.log, y_format=y_format)
        if chart is not None:
            found.append(chart)
    return found


def _term_charts(sets: Mapping[str, Sequence[Member]]) -> list[Chart]:
    tables = _tables(sets)
    names = dict.fromkeys(
        name for each in tables.values() for stage in each for name in stage.table if name.startswith(curves.REWARD)
    )
    found = []
    for name in names:
        lines = [over_seeds(each, name, label, i) for i, (label, each) in enumerate(tables.items())]
        if (chart := line_chart(name.removeprefix(curves.REWARD), lines, height=180)) is not None:
            chart.key = chart.title
            found.append(chart)
    return found


def _tiles(group: Group, sets: Mapping[str, Sequence[Member]]) -> list[tuple[str, str, str]]:
    rated = [member for member in group.members if _rate(member) is not None]
    tiles = []
    if rated:
        best = max(rated, key=lambda member: float(member.success or 0.0))
        tiles.append(("best run", f"{float(best.success or 0.0):.1%}", best.name))
        means = {name: success_over_seeds(members) for name, members in sets.items()}
        known = {name: found for name, found in means.items() if found is not None}
        if known and len(known) < len(rated):
            name = max(known, key=lambda each: known[each][0])
            tiles.append(("best mean over seeds", f"{known[name][0]:.1%}", name))
    seconds = [m.subject.seconds for m in group.members if m.subject is not None and math.isfinite(m.subject.seconds)]
    frames = sum(m.subject.frames for m in group.members if m.subject is not None)
    tiles.append(("trained", format_count(frames), f"environment steps, {duration(sum(seconds))}"))
    return tiles


def _short(key: str, keys: Sequence[str]) -> str:
    """Return the last part of a key where it is unambiguous."""
    last = key.rpartition(".")[2]
    return last if sum(each.rpartition(".")[2] == last for each in keys) <= 1 else key
