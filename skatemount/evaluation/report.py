"""Results as text for a terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from skatemount.evaluation.results import Evaluation
from skatemount.utils.tables import new_table, rendered


def table(result: Evaluation) -> str:
    """Return one evaluation as a table, with a second table by variant if the suite has variants."""
    low, high = result.interval
    made = new_table(result.title, "")
    made.add_row("episodes", str(result.episodes))
    made.add_row("success", f"{result.success_rate:.1%} (95 % interval {low:.1%} to {high:.1%})")
    if (worst := result.worst_board()) is not None:
        number, part = worst
        made.add_row(
            f"worst of {result.boards} boards", f"board {number}, {part.successes} of {part.episodes} episodes"
        )
    # The heading has room for a few.
    for setting in result.changed_by if len(result.changed_by) > 1 else []:
        made.add_row("changed by", setting)
    for metric in result.task.metrics:
        made.add_row(metric.label, result.text(metric.name))
    made.add_row("failures", failures(result))
    text = rendered(made)
    if result.variants and result.grid() is None:
        text += "\n\n" + overview(result.by_variant() | {"all of them": result}, "variant")
    if (grid := result.grid()) is not None:
        text += f"\n\n{grid.table()}"
    if (ladder := result.ladder()) is not None:
        text += f"\n\n{ladder.quantity}: success {ladder.verdict}"
    return text


def overview(results: Mapping[str, Evaluation], heading: str) -> str:
    """Return a table with a row for each of several evaluations.

    Args:
        results: The evaluations by name.
        heading: Heading of the column of names.
    """
    columns = {
        metric.name: metric.label
        for result in results.values()
        for metric in result.task.metrics_of(result.task.overview)
    }
    made = new_table(heading, "success", "95 % interval", *columns.values(), "main failure")
    for name, result in results.items():
        low, high = result.interval
        causes = result.failures()
        main = next(iter(causes), None)
        known = {metric.name: metric.short(result.number(metric.name)) for metric in result.task.metrics}
        made.add_row(
            name,
            f"{result.success_rate:.1%}",
            f"{low:.1%} to {high:.1%}",
            *(known.get(column, "-") for column in columns),
            "-" if main is None else f"{result.in_words(main)}, {causes[main]} of {result.episodes}",
        )
    return rendered(made)


def failures(result: Evaluation) -> str:
    """Return the number of failures and their causes in one line."""
    causes = result.failures()
    if not causes:
        return "none"
    return f"{sum(causes.values())}: " + ", ".join(f"{result.in_words(name)} {count}" for name, count in causes.items())


def failed_episodes(result: Evaluation, most: int = 5) -> str:
    """Return a table of the first failed episodes; an empty string if there are none.

    Args:
        result: The evaluation.
        most: Number of episodes to list.
    """
    failed = result.failed_episodes()
    if not failed:
        return ""
    names = ["failed episode", *(["variant"] if result.variants else []), "x", "y", "heading", "ended by", "after"]
    made = new_table(*names)
    for each in failed[:most]:
        made.add_row(*_row(each, result))
    more = f"\n  and {len(failed) - most} more" if len(failed) > most else ""
    return rendered(made) + more


def next_commands(commands: Mapping[str, str]) -> str:
    """Return the commands that a user may want next, one per line, each with its purpose.

    Args:
        commands: The commands by their purpose, such as "film a failure".
    """
    width = max(map(len, commands), default=0) + 1
    return "\n".join(f"{f'{purpose}:':{width}} {command}" for purpose, command in commands.items())


def _row(failed: dict[str, Any], result: Evaluation) -> list[str]:
    start = failed["start"]
    return [
        str(failed["episode"]),
        *([failed["variant"]] if "variant" in failed else []),
        f"{start['x']:+.2f} m",
        f"{start['y']:+.2f} m",
        f"{math.degrees(start['yaw']):+.0f}°",
        result.in_words(failed["ended_by"]),
        f"{failed['ended_after']:.2f} s",
    ]
