"""The page of one run, or of two runs against each other."""

from __future__ import annotations

import datetime
import math
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from skatemount.config import compose_task
from skatemount.reports import curves
from skatemount.reports.charts import Chart
from skatemount.reports.episodes import Evaluated, Film
from skatemount.reports.facts import (
    about_rows,
    compute_rows,
    default_config,
    differences,
    duration,
    final_score,
    last_evaluation,
    short_names,
)
from skatemount.reports.page import data_uri, render, shown
from skatemount.reports.subjects import Stage, Subject, flat, joined
from skatemount.reports.suites import AT_END, FOR_PAGE, OWN_TASK, Result, measured_rows, suite_charts, suite_rows
from skatemount.utils.errors import ConfigError
from skatemount.utils.formatting import format_count

MAX_FAILED = 12
"""Failed episodes in the table."""

QUOTED = "approach-unfixed"
"""The suite that pages quote for a policy that mounts boards."""


@dataclass
class Content:
    """All that a page of one run, or of two, shows.

    Attributes:
        run: The run.
        other: The run that it is compared with; None compares its settings with the defaults.
        results: For each of them its results by suite.
        others: Results of other policies.
        evaluated: Evaluations that were made for the page, of the run and then of the other one.
        films: The films.
        notes: Remarks about what is not in the page.
    """

    run: Subject
    other: Subject | None = None
    results: list[dict[str, Result]] = field(default_factory=list)
    others: list[Result] = field(default_factory=list)
    evaluated: list[Evaluated] = field(default_factory=list)
    films: list[Film] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    @property
    def subjects(self) -> dict[str, Subject]:
        """The runs by short names."""
        found = [self.run] if self.other is None else [self.run, self.other]
        return dict(zip(short_names([each.name for each in found]), found))

    @property
    def columns(self) -> dict[str, dict[str, Result]]:
        """Results by suite, of each run and then of other policies, without those that have none."""
        found = dict(zip(self.subjects, self.results))
        for result in self.others:
            found.setdefault(result.policy[0] or result.source, {}).setdefault(result.name, result)
        return {name: column for name, column in found.items() if column}


def run_page(content: Content, command: str) -> str:
    """Return the page.

    Args:
        content: Its content.
        command: Command that writes it.
    """
    run, subjects = content.run, content.subjects
    names = list(subjects)
    columns = content.columns
    context = {
        "title": " against ".join(subject.name for subject in subjects.values()),
        "subtitle": _subtitle(run),
        "kind": "comparison of two runs" if content.other else "training report",
        "made": f"{datetime.datetime.now():%Y-%m-%d %H:%M}",
        "command": command,
        "names": names,
        "tiles": _tiles(content),
        "about": about_rows(list(subjects.values())),
        "repeat": [(name, _repeat(subject)) for name, subject in subjects.items()],
        "differences": _differences(content),
        "settings": [(key, shown(value)) for key, value in flat(run.config).items()],
        "compute": compute_rows(list(subjects.values())),
        "speed": _speed(subjects),
        "chain": _chain(run),
        "stages": stage_sections(subjects),
        "suites": suite_rows(columns),
        "measured": measured_rows(columns),
        "columns": list(columns),
        "suite_charts": suite_charts(columns),
        "maps": [(f"{each.task.agent.name} on {each.result.name}", data_uri(each.success_map, "image/png"))
                 for each in content.evaluated],
        "films": content.films,
        "failed": _failed(content),
        "notes": content.notes,
        "sources": [(name, subject) for name, subject in subjects.items()],
    }  # fmt: skip
    return render("run.html.jinja", context)


def stage_sections(subjects: Mapping[str, Subject]) -> list[dict[str, Any]]:
    """Return charts, reward terms and ends of each training of the first run, with the other's beside them."""
    (run, *rest) = subjects.values()
    sections = []
    for i, stage in enumerate(run.stages):
        stages = {next(iter(subjects)): stage}
        for name, other in zip(list(subjects)[1:], rest):
            if (found := _counterpart(other, stage, i, len(run.stages))) is not None:
                stages[name] = found
        logged = {name: each for name, each in stages.items() if each.table}
        if stage.table:
            sections.append(_section(stage, logged))
        else:
            sections.append({"name": stage.name, "facts": "no metrics were logged", "groups": [], "terms": [],
                             "term_charts": [], "ends": [], "picture": None, "names": list(stages)})  # fmt: skip
    return sections


def _chain(run: Subject) -> list[Chart]:
    """Return the curves of a chain as a whole; none for a single training."""
    if len(run.stages) < 2 or (found := joined(run)) is None:
        return []
    whole, starts = found
    made = [curves.panel_chart(panel, {run.name: whole}, starts) for panel in curves.LEARNING[:2]]
    return [chart for chart in made if chart is not None]


def _section(stage: Stage, stages: dict[str, Stage]) -> dict[str, Any]:
    learning = [*curves.LEARNING, *curves.task_panels(list(stages.values()))]
    shown_panels = [*learning, *curves.UPDATES, *curves.CURRICULUM, *curves.SPEED]
    groups = [
        ("Success and reward", curves.charts(learning, stages), True),
        ("Curriculum", curves.charts(curves.CURRICULUM, stages), True),
        ("Updates", curves.charts(curves.UPDATES, stages), False),
        ("Other metrics", curves.others(stages, shown_panels), False),
    ]
    frames, seconds = format_count(stage.frames), duration(stage.seconds)
    picture = stage.curriculum_png
    return {
        "name": stage.name,
        "facts": f"{frames} environment steps in {seconds}, {len(stage.steps):,} iterations",
        "groups": [(name, found, is_open) for name, found, is_open in groups if found],
        "terms": curves.terms(stages),
        "term_charts": curves.prefixed(curves.REWARD, stages),
        "ends": curves.prefixed(curves.TERMINATION, stages, curves.percent),
        "picture": None if picture is None else data_uri(picture.read_bytes(), "image/png"),
        "names": list(stages),
    }


def _counterpart(other: Subject, stage: Stage, place: int, count: int) -> Stage | None:
    """Return the other run's training that a training is compared with: of the same stage, or at the same place."""
    same = [each for each in other.stages if each.name == stage.name]
    if same:
        return same[0]
    return other.stages[place] if len(other.stages) == count else None


def _subtitle(run: Subject) -> str:
    stages = " → ".join(stage.name for stage in run.stages) or (run.card.stage if run.card else "")
    return f"{stages}, {format_count(run.frames)} environment steps"


def _tiles(content: Content) -> list[tuple[str, str, str]]:
    """Return label, value and note of the facts at the top."""
    tiles = []
    for name, subject, results in zip(content.subjects, content.subjects.values(), content.results):
        who = f" · {name}" if content.other else ""
        first = headline(subject, results)
        score = final_score(subject)
        if first is not None:
            rate = first.rate
            tiles.append((f"success{who}", f"{rate[0]:.1%}", f"{rate[1]:.1%} to {rate[2]:.1%}, {first.name}, "
                          f"{_episodes(first.episodes)}"))  # fmt: skip
        elif score is not None:
            tiles.append((f"success{who}", f"{float(score):.1%}", _episodes(score.episodes)))
        elif (last := last_evaluation(subject)) is not None:
            tiles.append((f"success{who}", f"{last[0]:.1%}", f"of the evaluation after {format_count(last[1])} steps"))
        tiles.append((f"trained{who}", format_count(subject.frames), "environment steps"))
        tiles.append((f"time{who}", duration(subject.seconds), _speed_in_words(subject)))
    return tiles


def headline(subject: Subject, results: Mapping[str, Result]) -> Result | None:
    """Return the result that stands for a run, or None if there is none.

    That is one of the stage of its training. Without it, it is that of `QUOTED` or of the first suite with the task of
    the training: how a policy walks says nothing about how often it mounts.

    Args:
        subject: The run.
        results: Its results by name.
    """
    stage = subject.stages[-1].name if subject.stages else subject.card.stage if subject.card else ""
    named = (results.get(f"{stage} ({when})") for when in (FOR_PAGE, AT_END))
    own = (result for result in results.values() if result.stage == stage or result.name == OWN_TASK)
    if found := next(filter(None, named), None) or next(own, None):
        return found
    task = subject.card.config.get("success") if subject.card else None
    same = {name: result for name, result in results.items() if task is not None and _task(result.stage) == task}
    return same.get(QUOTED) or next(iter((same or results).values()), None)


def _task(stage: str) -> str | None:
    """Return the name of a stage's task; None for a stage that is not there, such as one of another folder."""
    try:
        return compose_task(stage).success if stage else None
    except ConfigError:
        return None


def _episodes(count: int) -> str:
    return f"{count:,} episode{'s' * (count != 1)}"


def _speed_in_words(subject: Subject) -> str:
    seconds = subject.seconds
    if not math.isfinite(seconds) or seconds <= 0:
        return "not known"
    return f"{subject.frames / seconds:,.0f} steps a second over all"


def _repeat(subject: Subject) -> dict[str, Any]:
    commands = []
    if subject.command is not None:
        commands.append(("train it again", subject.command))
    elif subject.card is not None and subject.card.notes.startswith("Trained by: "):
        commands.append(("its card says", subject.card.notes.partition(" Failures in ")[0]))
    if subject.spec is not None:
        checkpoint = f"checkpoint={subject.spec}"
        commands.append(("evaluate its policy", shlex.join(["python", "-m", "skatemount.evaluate", checkpoint])))
        commands.append(("film it", shlex.join(["python", "-m", "skatemount.record", checkpoint])))
    changed = "with uncommitted changes, which are at the end of this page" if subject.difference else ""
    return {"commands": commands, "commit": subject.commit, "changed": changed}


def _differences(content: Content) -> dict[str, Any]:
    if content.other is not None:
        label, theirs = list(content.subjects)[1], content.other.config
    else:
        try:
            label, theirs = default_config(content.run)
        except ConfigError as error:
            return {"heads": [], "rows": [], "note": f"The defaults cannot be composed: {error}"}
    rows = differences(content.run.config, theirs)
    return {"heads": [content.run.name, label], "rows": rows, "note": "" if rows else f"None: they equal {label}."}


def _speed(subjects: Mapping[str, Subject]) -> list[Chart]:
    stages = {name: subject.stages[-1] for name, subject in subjects.items() if subject.stages}
    stages = {name: stage for name, stage in stages.items() if stage.table}
    return curves.charts(curves.SPEED, stages) if stages else []


def _failed(content: Content) -> dict[str, Any] | None:
    """Return the first failed episodes of the first evaluation that has some, with the command that films one."""
    for each in content.evaluated:
        failed = each.evaluation.failed_episodes()
        if not failed:
            continue
        heads = ["episode", "x, m", "y, m", "heading, °", "after, s", "ended by"]
        rows = [
            [
                str(row["episode"]),
                f"{row['start']['x']:+.2f}",
                f"{row['start']['y']:+.2f}",
                f"{math.degrees(row['start']['yaw']):+.0f}",
                f"{row['ended_after']:.2f}",
                each.evaluation.in_words(row["ended_by"]),
            ]
            for row in failed[:MAX_FAILED]
        ]
        if each.evaluation.variants:
            heads.append("variant")
            rows = [[*cells, row["variant"]] for cells, row in zip(rows, failed)]
        return {
            "title": f"{each.task.agent.name} on {each.result.name}",
            "heads": heads,
            "rows": rows,
            "more": len(failed) - len(rows),
            "command": each.task.record_command(failed[0]["episode"]),
        }
    return None
