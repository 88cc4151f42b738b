"""Results as text for a terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from skatemount.utils.tables import new_table, rendered

if TYPE_CHECKING:
    from skatemount.evaluation.results import Evaluation

_IN_WORDS = {
    "not_mounted": "not mounted at the time limit",
    "not_followed": "did not follow the command",
    "diverged": "physics failed",
}


def in_words(end: str) -> str:
    """What ended a failed episode, in words."""
    return _IN_WORDS.get(end, end.replace("_", " "))


def table(result: Evaluation) -> str:
    """One evaluation, several lines; with a row for each variant, if there are any."""
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


def overview(results: Mapping[str, Evaluation], what: str) -> str:
    """A row for each of several evaluations.

    Args:
        results: The evaluations by name.
        what: What the names are names of.
    """
    made = new_table(what, "success", "95 % interval", "time to mount", "feet", "main failure")
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
    """How many episodes failed, and by what, in a line."""
    causes = result.failures()
    if not causes:
        return "none"
    return f"{sum(causes.values())}: " + ", ".join(f"{in_words(name)} {count}" for name, count in causes.items())


def failed_episodes(result: Evaluation, command: str, most: int = 5) -> str:
    """The first failed episodes, and how to film one; an empty string if there are none.

    Args:
        result: The evaluation.
        command: What films the first of them.
        most: How many episodes to list.
    """
    failed = result.failed_episodes()
    if not failed:
        return ""
    names = ["failed episode", *(["variant"] if result.variants else []), "x", "y", "heading", "ended by", "after"]
    made = new_table(*names)
    for each in failed[:most]:
        made.add_row(*_row(each))
    more = f"\n  and {len(failed) - most} more" if len(failed) > most else ""
    return f"{rendered(made)}{more}\n\nfilm one of them: {command}"


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
