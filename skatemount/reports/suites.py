"""Read results of evaluations, whatever wrote them, and show them as tables and charts."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from skatemount.envs.tasks import TASKS
from skatemount.evaluation.results import in_words
from skatemount.reports.charts import Chart, Interval, Line, interval_chart, line_chart
from skatemount.utils.errors import ConfigError
from skatemount.utils.formatting import format_changes

OWN_TASK = "the task of its training"

FOR_PAGE, AT_END = "evaluated for this page", "at the end of the training"
"""Behind the name of a stage: when a policy was evaluated in the task of its training."""

HOLDS = 0.9
"""Success rate that a step of a ladder must reach to be held."""

MIN_STEPS = 3
"""Least number of steps of a ladder."""

_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?")


@dataclass
class Result:
    """Result of a suite, or of one of its variants.

    Attributes:
        name: Name of the suite or variant.
        document: What the evaluation wrote about it.
        source: File or card that it comes from.
        policy: Name and checksum of the policy, as far as the results say it.
        variants: Results of the variants by name, in the order of the file.
    """

    name: str
    document: Mapping[str, Any]
    source: str = ""
    policy: tuple[str, str] = ("", "")
    variants: dict[str, Result] = field(default_factory=dict)

    @property
    def rate(self) -> tuple[float, float, float]:
        """Success rate, lower and upper end of its interval."""
        success = self.document["success"]
        return float(success["rate"]), float(success["low"]), float(success["high"])

    @property
    def episodes(self) -> int:
        """Number of episodes."""
        return int(self.document["episodes"])

    @property
    def failures(self) -> dict[str, int]:
        """Number of failures by their cause in words, the most frequent first."""
        tasks = [TASKS.get(name) for name in TASKS.names()]
        said = self.document.get("failures", {})
        found = {}
        for name, count in said.items():
            task = next((task for task in tasks if task.failure == name), tasks[0])
            found[in_words(str(name), task)] = int(count)
        return found

    @property
    def version(self) -> str:
        """Version of the suite; "" if the results do not say it."""
        definition = self._definition
        found = self.document.get("version", definition.get("version"))
        return "" if found is None else str(found)

    @property
    def description(self) -> str:
        """Description of the suite; "" if the results have none."""
        return str(self.document.get("description") or self._definition.get("description") or "")

    @property
    def stage(self) -> str:
        """Stage whose task the suite has; "" if the results do not say it."""
        return str(self.document.get("stage") or self._definition.get("stage") or "")

    def metrics(self) -> str:
        """Return label and value of each metric that a task of this version has, in one line."""
        known = {metric.name: metric for name in TASKS.names() for metric in TASKS.get(name).metrics}
        said = [f"{m.label} {m.text(self.document[name])}" for name, m in known.items() if name in self.document]
        return ", ".join(said)

    def main_metrics(self) -> str:
        """Return label and value of the metrics that its task shows in an overview, in one line."""
        for name in TASKS.names():
            metrics = TASKS.get(name).metrics_of(TASKS.get(name).overview)
            if metrics and all(metric.name in self.document for metric in metrics):
                numbers = [(metric, metric.reduce.number(self.document[metric.name])) for metric in metrics]
                return ", ".join(f"{metric.label} {metric.short(number)}" for metric, number in numbers)
        return ""

    @property
    def _definition(self) -> Mapping[str, Any]:
        found = self.document.get("evaluated", {}).get("definition")
        return found if isinstance(found, dict) else {}


def parse(document: Any, where: str) -> list[Result]:
    """Return the results in a document: that of one evaluation, or of several by suite.

    Args:
        document: What ``json=`` of `skatemount.evaluate`, a results file of the docs or ``evaluation.json`` holds.
        where: Its file or card, for readers and messages.

    Raises:
        ConfigError: It holds no results.
    """
    if isinstance(document, dict) and isinstance(document.get("suites"), dict):
        found = [result for name, part in document["suites"].items() for result in parse_named(name, part, where)]
        for result in found:
            result.policy = _policy(result.document, document)
        return found
    if isinstance(document, dict):
        about = document.get("evaluated")
        name = about.get("suite") if isinstance(about, dict) else None
        (result,) = parse_named(str(name or OWN_TASK), document, where)
        result.policy = _policy(document)
        return [result]
    raise ConfigError(f"{where}: no results of an evaluation; python -m skatemount.evaluate json=<file> writes them")


def _policy(*documents: Mapping[str, Any]) -> tuple[str, str]:
    """Return name and checksum of the policy that documents name, the first one that does."""
    abouts = [part for document in documents for part in (document.get("evaluated"), document)]
    known = [part for part in abouts if isinstance(part, dict)]
    name = next((str(part["checkpoint"]) for part in known if part.get("checkpoint")), "")
    return name, next((str(part["sha256"]) for part in known if part.get("sha256")), "")


def parse_named(name: str, document: Any, where: str) -> list[Result]:
    """Return the result of one suite, as a list.

    Raises:
        ConfigError: It has no success rate or number of episodes.
    """
    success = document.get("success") if isinstance(document, dict) else None
    if not isinstance(success, dict) or not {"rate", "low", "high"} <= success.keys() or "episodes" not in document:
        raise ConfigError(
            f"{where}: {name} has no results of an evaluation (success with rate, low and high; episodes)"
        )
    variants = document.get("variants")
    parts = variants if isinstance(variants, dict) else {}
    found = {each: parse_named(each, part, where)[0] for each, part in parts.items()}
    about = document.get("evaluated")
    if isinstance(about, dict) and isinstance(changes := about.get("changed_by"), list):
        # A row of its own: it is no result of the suite.
        name += format_changes([str(each) for each in changes])
    return [Result(name, document, where, variants=found)]


def read_results(paths: Sequence[str]) -> list[Result]:
    """Read the files of ``page.results``.

    Args:
        paths: Files, or folders whose ``*.json`` are read.

    Raises:
        ConfigError: A file does not exist, or holds no results.
    """
    found: list[Result] = []
    for given in paths:
        path = Path(given)
        files = sorted(path.glob("*.json")) if path.is_dir() else [path]
        if not files:
            raise ConfigError(f"page.results={given}: the folder has no *.json file")
        for file in files:
            try:
                document = json.loads(file.read_bytes())
            except OSError as error:
                raise ConfigError(f"page.results={given}: cannot be read ({error.strerror})") from error
            except ValueError as error:
                raise ConfigError(f"page.results={given}: {file} is not JSON ({error})") from error
            found += parse(document, str(file))
    return found


def results_in(folder: Path, stage: str = "") -> list[Result]:
    """Return the results that lie in a run's folder, or in folders of it; other files are left alone.

    A part of a chain gives its name to the result of its own task; the last part comes first.

    Args:
        folder: The run's folder.
        stage: Stage of the run, the name of its own task; "" if it is not known.
    """
    found: list[Result] = []
    for file in [*sorted(folder.glob("*.json")), *sorted(folder.glob("*/*.json"), key=_place, reverse=True)]:
        try:
            document = json.loads(file.read_bytes())
            if not isinstance(document, dict) or not {"suites", "success"} & document.keys():
                continue
            for result in parse(document, file.relative_to(folder).as_posix()):
                if (frames := document.get("frames")) is not None:
                    result.source += f", after {frames:,} steps"
                name = stage if file.parent == folder else file.parent.name
                if result.name == OWN_TASK and name:
                    result.name = f"{name} ({AT_END})"
                found.append(result)
        except (OSError, ValueError):
            # A record of something else; ConfigError is a ValueError.
            continue
    return found


def _place(file: Path) -> tuple[int, str]:
    """Return a sort key of a file in a run: the number of the part that it lies in, then its name."""
    number = file.parent.name.partition("_")[0]
    return int(number) if number.isdecimal() else 0, file.name


def merged(*groups: Sequence[Result]) -> dict[str, Result]:
    """Return results by suite; of several of the same suite the one in the first group counts."""
    found: dict[str, Result] = {}
    for result in (result for group in groups for result in group):
        found.setdefault(result.name, result)
    return found


def interval_figure(title: str, columns: Mapping[str, Mapping[str, Result]]) -> Chart | None:
    """Return the chart of success rates, a row for each suite and a color for each column.

    Args:
        title: Heading.
        columns: Results by suite, of each run or policy by its name.
    """
    names = list(dict.fromkeys(name for column in columns.values() for name in column))
    rows = [
        Interval(name, [column[name].rate if name in column else None for column in columns.values()]) for name in names
    ]
    return interval_chart(title, rows, list(columns), note="Dots: success rate; bars: Wilson's 95 % interval.")


def variant_figures(columns: Mapping[str, Mapping[str, Result]]) -> Iterator[Chart]:
    """Yield a chart for each suite with variants: a curve for a ladder, whose variants differ in one number alone.

    The note of a ladder says where each policy falls below `HOLDS`.

    Args:
        columns: As for `interval_figure`.
    """
    for suite in dict.fromkeys(name for column in columns.values() for name in column):
        parts = {name: column[suite].variants for name, column in columns.items() if suite in column}
        variants = list(dict.fromkeys(each for found in parts.values() for each in found))
        if len(variants) < 2:
            continue
        steps = _steps(variants)
        if steps is None:
            rows = [Interval(v, [found[v].rate if v in found else None for found in parts.values()]) for v in variants]
            if (chart := interval_chart(f"{suite}, by variant", rows, list(parts))) is not None:
                yield chart
            continue
        unit, places = steps
        lines: list[Line | None] = [
            Line(f"{HOLDS:.0%}", np.array(places)[[0, -1]], np.array([HOLDS, HOLDS]), color=7, dashed=True)
        ]
        held = []
        for i, (name, found) in enumerate(parts.items()):
            known = [(place, found[v].rate) for place, v in zip(places, variants) if v in found]
            if not known:
                # An older version of the suite had no steps.
                continue
            rate = np.array([value for _, value in known])
            x = np.array([place for place, _ in known])
            lines.append(Line(name, x, rate[:, 0], i, rate[:, 1], rate[:, 2], dots=True))
            below = [v for v in variants if v in found and found[v].rate[0] < HOLDS]
            end = f"falls below {HOLDS:.0%} at {below[0]}" if below else f"holds {HOLDS:.0%} to the end"
            held.append(f"{name} {end}.")
        ladder = line_chart(
            f"ladder {suite}",
            lines,
            limits=(0.0, 1.02),
            x_label=unit or "step",
            x_format=lambda value: f"{value:g}",
            y_format=lambda value: f"{value:.0%}",
            note=" ".join([*held, "Bands: Wilson's 95 % intervals."]),
        )
        if ladder is not None:
            yield ladder


def suite_rows(columns: Mapping[str, Mapping[str, Result]]) -> list[dict[str, Any]]:
    """Return a row for each suite: what it is, and the success of each run."""
    rows = []
    for suite in dict.fromkeys(name for column in columns.values() for name in column):
        found = [column.get(suite) for column in columns.values()]
        first = next(each for each in found if each is not None)
        rows.append(
            {
                "suite": suite,
                "description": first.description,
                "rates": [
                    None if result is None else (result.rate, result.episodes, result.version) for result in found
                ],
                "metrics": first.main_metrics(),
                "failures": ", ".join(f"{cause} {count}" for cause, count in first.failures.items()) or "none",
            }
        )
    return rows


def measured_rows(columns: Mapping[str, Mapping[str, Result]]) -> list[tuple[str, str, str, str, str]]:
    """Return suite, run, metrics, failures and source of each result."""
    return [
        (suite, name, result.metrics(), ", ".join(f"{c} {n}" for c, n in result.failures.items()) or "none",
         result.source)
        for name, column in columns.items()
        for suite, result in column.items()
    ]  # fmt: skip


def suite_charts(columns: Mapping[str, Mapping[str, Result]]) -> list[Chart]:
    """Return the charts of results: all suites if there are several policies, and each suite with variants."""
    overall = interval_figure("success by suite", columns) if len(columns) > 1 else None
    return [*([] if overall is None else [overall]), *variant_figures(columns)]


def _steps(variants: Sequence[str]) -> tuple[str, list[float]] | None:
    """Return unit and numbers of variants that are steps of a ladder, such as ``0.5 m/s``; None if they are not."""
    if len(variants) < MIN_STEPS:
        return None
    numbers, words = [], set()
    for name in variants:
        found = _NUMBER.findall(name)
        if len(found) != 1:
            return None
        numbers.append(float(found[0]))
        words.add(" ".join(_NUMBER.sub(" ", name).split()))
    rising = all(a < b for a, b in zip(numbers, numbers[1:]))
    falling = all(a > b for a, b in zip(numbers, numbers[1:]))
    return (words.pop(), numbers) if len(words) == 1 and (rising or falling) else None
