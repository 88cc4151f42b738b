"""Results as text for a terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from skatemount.evaluation.results import Evaluation
from skatemount.utils.tables import new_table, rendered

_IN_WORDS = {
    "not_mounted": "not mounted at the time limit",
    "not_followed": "did not follow the command",
    "diverged": "physics failed",
}


def in_words(end: str) -> str:
    """Return the name of an episode's end in words."""
    return _IN_WORDS.get(end, end.replace("_", " "))


def table(result: Evaluation) -> str:
    """Return one evaluation as a table, with a second table by variant if the suite has variants."""
    low, high = result.interval
    rows = {
        "episodes": str(result.episodes),
        "success": f"{result.success_rate:.1%} (95 % interval {low:.1%} to {high:.1%})",
        "time to mount": _spread(result.time_to_mount(0.5), result.time_to_mount(0.95), "s"),
        "feet on board": f"{result.feet_on_board:.2f} of 4 in the last second",
        "board moved": _spread(result.displacement(0.5), result.displacement(0.95), "m"),
        "slips": f"{result.slips:.2f} an episode",
        "energy": f"{result.energy:.0f} J an episode",
        "failures": failures(result),
    }
    made = new_table(result.title, "")
    for name, value in rows.items():
        made.add_row(name, value)
    text = rendered(made)
    if result.variants:
        text += "\n\n" + overview(result.by_variant() | {"all of them": result}, "variant")
    return text


def overview(results: Mapping[str, Evaluation], heading: str) -> str:
    """Return a table with a row for each of several evaluations.

    Args:
        results: The evaluations by name.
        heading: Heading of the column of names.
    """
    made = new_table(heading, "success", "95 % interval", "time to mount", "feet", "main failure")
    for name, result in results.items():
        low, high = result.interval
        median = result.time_to_mount(0.5)
        causes = result.failures()
        main = next(iter(causes), None)
        made.add_row(
            name,
            f"{result.success_rate:.1%}",
            f"{low:.1%} to {high:.1%}",
            "-" if median is None else f"{median:.2f} s",
            f"{result.feet_on_board:.2f}",
            "-" if main is None else f"{in_words(main)}, {causes[main]} of {result.episodes}",
        )
    return rendered(made)


def failures(result: Evaluation) -> str:
    """Return the number of failures and their causes in one line."""
    causes = result.failures()
    if not causes:
        return "none"
    return f"{sum(causes.values())}: " + ", ".join(f"{in_words(name)} {count}" for name, count in causes.items())


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
        made.add_row(*_row(each))
    more = f"\n  and {len(failed) - most} more" if len(failed) > most else ""
    return rendered(made) + more


def next_commands(commands: Mapping[str, str]) -> str:
    """Return the commands that a user may want next, one per line, each with its purpose.

    Args:
        commands: The commands by their purpose, such as "film a failure".
    """
    width = max(map(len, commands), default=0) + 1
    return "\n".join(f"{f'{purpose}:':{width}} {command}" for purpose, command in commands.items())


def _row(failed: dict[str, Any]) -> list[str]:
    start = failed["start"]
    return [
        str(failed["episode"]),
        *([failed["variant"]] if "variant" in failed else []),
        f"{start['x']:+.2f} m",
        f"{start['y']:+.2f} m",
        f"{math.degrees(start['yaw']):+.0f}°",
        in_words(failed["ended_by"]),
        f"{failed['ended_after']:.2f} s",
    ]


def _spread(median: float | None, p95: float | None, unit: str) -> str:
    return "-" if median is None else f"median {median:.2f} {unit}, 95 % within {p95:.2f} {unit}"
