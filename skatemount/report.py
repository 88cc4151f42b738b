"""`python -m skatemount.report run=...`: one HTML page about a run, two runs, a sweep, or the paper."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from skatemount.utils.signals import exiting_by_signals

if TYPE_CHECKING:
    from skatemount.config import ReportConfig
    from skatemount.reports.episodes import Evaluated, Film
    from skatemount.reports.subjects import Subject
    from skatemount.reports.suites import Result

FILE = "report.html"
"""Name of the page if the user names none."""


def report(config: ReportConfig, overrides: list[str]) -> None:
    """Write a page and print where it is.

    Settings: ``run`` and ``against``, ``runs``, ``sweep`` or ``paper`` (what the page is about), ``page.*`` (what is in
    it, see `skatemount.config.report.PageConfig`), ``output`` (its file), and any setting of the task, which the
    evaluations for the page take.

    Args:
        config: As composed from the command line.
        overrides: The settings that the user gave.

    Raises:
        ConfigError: There is no such run, policy, suite or file of results.
    """
    from skatemount import config as configuration
    from skatemount.runs import atomic
    from skatemount.utils.errors import ConfigError

    if config.output is not None and Path(config.output).is_dir():
        raise ConfigError(f"output={config.output} is a folder; it must name a file, such as {config.output}/{FILE}")
    command = shlex.join(["python", "-m", "skatemount.report", *configuration.config_dir_options(), *overrides])
    if config.paper:
        html, place = _paper(config, command), None
    elif config.sweep is not None or config.runs:
        html, place = _several(config, overrides, command)
    else:
        html, place = _one(config, overrides, command)
    path = Path(config.output) if config.output is not None else (place or Path()) / FILE
    path.parent.mkdir(parents=True, exist_ok=True)
    atomic.write_text(path, html)
    print(f"written to {path} ({len(html.encode()) / 1e6:.1f} MB)")


def _one(config: ReportConfig, overrides: Sequence[str], command: str) -> tuple[str, Path | None]:
    """Return the page of one run, or of two, and the folder of the first one."""
    from skatemount.config.report import OWN
    from skatemount.reports import episodes, suites
    from skatemount.reports.run_page import Content, run_page
    from skatemount.reports.subjects import find_subject

    root, page = config.logger.root, config.page
    run = find_subject(config.run or "latest", root)
    other = None if config.against is None else find_subject(config.against, root, "against")
    given = suites.read_results(page.results)
    content = Content(run, other)
    asked = [OWN] if page.suites is None else page.suites
    for subject in (run, other):
        if subject is None:
            continue
        made = []
        if subject.spec is None and asked:
            content.notes.append(f"{subject.name} has no checkpoint yet, so no policy was evaluated.")
        elif asked:
            made = episodes.evaluate(subject.spec or "", config, asked, episodes.task_overrides(overrides), _say)
        content.evaluated += made
        theirs = [result for result in given if _is_of(result, subject, run)]
        content.results.append(_results(subject, made, theirs))
        given = [result for result in given if result not in theirs]
    content.others = given
    content.films = _films(config, content.evaluated, content.notes, run)
    return run_page(content, command), run.folder


def _is_of(result: Result, subject: Subject, run: Subject | None = None) -> bool:
    """Return whether a result is of a run: of its policy, or of another checkpoint of it.

    A result that does not say whose it is counts for the run that the page is about.
    """
    name, checksum = result.policy
    if checksum and subject.card is not None and checksum == subject.card.sha256:
        return True
    if name:
        return name.partition("/")[0] == subject.name
    return not checksum and subject is run


def _results(subject: Subject, made: Sequence[Evaluated], given: Sequence[Result]) -> dict[str, Result]:
    """Return a run's results by suite: those made for the page, then given ones, then those that it has."""
    from skatemount.reports import suites

    stage = subject.stages[-1].name if len(subject.stages) == 1 else ""
    own = [] if subject.folder is None else suites.results_in(subject.folder, stage)
    if subject.card is not None and subject.card.suites:
        own += suites.parse({"suites": subject.card.suites}, f"card of {subject.name}")
    return suites.merged([each.result for each in made], given, own)


def _films(config: ReportConfig, evaluated: Sequence[Evaluated], notes: list[str], run: Subject) -> list[Film]:
    """Film the chosen episodes, and add the films of the run's folder, as far as they fit into the page."""
    from skatemount.reports import episodes
    from skatemount.utils.decoration import Decoration
    from skatemount.utils.formatting import format_changes

    films: list[Film] = []
    reason = _no_opengl()
    if config.page.films and evaluated and reason is not None:
        notes.append(f"No episode was filmed: {reason}")
    elif config.page.films:
        drawing = Decoration("the film of an episode")
        for each, number, kind in episodes.chosen_episodes(evaluated, config.page.films):
            own = " (its own task)" if each.task.suite is None else ""
            named = f"{each.task.name}{own}{format_changes(each.task.changed_by)}"
            _say(f"filming the {kind} episode of {named}, number {number}")
            with drawing:
                films.append(episodes.film(each, number, kind, config.page.film_width))
        if drawing.failed:
            notes.append(f"{drawing.failed} films could not be made.")
    kept, left = episodes.fitting([*films, *episodes.films_of_run(run.folder)], config.page.megabytes)
    if left:
        notes.append(
            f"Left out, because page.megabytes={config.page.megabytes:g} has no room for them: {', '.join(left)}."
        )
    return kept


def _several(config: ReportConfig, overrides: Sequence[str], command: str) -> tuple[str, Path | None]:
    """Return the page of a sweep or of several runs, and the sweep's folder."""
    from skatemount.reports import episodes, suites
    from skatemount.reports.sweep_page import read_group, sweep_page

    group = read_group(config)
    given = suites.read_results(config.page.results)
    for member in group.members:
        subject = member.subject
        if subject is None:
            continue
        made = []
        if config.page.suites and subject.spec is not None:
            made = episodes.evaluate(subject.spec, config, config.page.suites, episodes.task_overrides(overrides), _say)
        theirs = [result for result in given if _is_of(result, subject)]
        given = [result for result in given if result not in theirs]
        if found := _results(subject, made, theirs):
            group.columns[member.name] = found
    for result in given:
        group.columns.setdefault(result.policy[0] or result.source, {}).setdefault(result.name, result)
    return sweep_page(group, command), group.folder


def _paper(config: ReportConfig, command: str) -> str:
    """Return the page of the paper."""
    from skatemount.reports import episodes, suites
    from skatemount.reports.paper_page import STRIP, paper_page
    from skatemount.reports.subjects import find_subject
    from skatemount.utils.decoration import Decoration

    run = None if config.run is None else find_subject(config.run, config.logger.root)
    strip = None
    if config.page.films and _no_opengl() is None:
        _say(f"drawing six moments of {STRIP[0]} on {STRIP[1]}")
        with Decoration("the strip of six moments"):
            strip = episodes.six_moments(episodes.prepared(*STRIP, config))
    return paper_page(run, command, suites.read_results(config.page.results), strip)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


_reason: str | None = None


def _no_opengl() -> str | None:
    """Return why nothing can be drawn here; None if it can."""
    return _reason


def main() -> None:
    """Run the program."""
    global _reason
    with exiting_by_signals("report"):
        from skatemount.rendering import opengl
        from skatemount.utils.errors import ConfigError

        try:
            opengl.choose()
        except ConfigError as error:
            # A page without films is better than none.
            _reason = str(error)
            opengl.disable()
        # Only now: importing the configuration imports dm_control, which asks once how to draw.
        from skatemount import cli

        cli.run(report, "report")


if __name__ == "__main__":
    main()
