"""Table of a sweep: what its jobs reached, and the means over seeds."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from typing import Any

from skatemount.evaluation.intervals import wilson_interval
from skatemount.utils.formatting import format_count
from skatemount.utils.tables import new_table, rendered

SEED = "seed"


def document(records: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the results of a sweep as plain values for JSON.

    Args:
        records: Records of its jobs, as `skatemount.runs.sweep.Job.write_record` writes them.

    Returns:
        ``jobs``, each with Wilson's 95 % interval, and ``over_seeds``, the means over the seeds of each combination of
        the other settings, if the seed is one of the settings that differ.
    """
    jobs = []
    for record in records:
        interval = _interval(record)
        low, high = interval if interval is not None else (None, None)
        known = {name: value for name, value in record.items() if name not in ("format", "overrides")}
        jobs.append(known | {"low": low, "high": high})
    return {"jobs": jobs, "over_seeds": over_seeds(records)}


def over_seeds(records: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return mean, least and greatest success over the seeds, for each combination of the other settings.

    Args:
        records: As for `document`. Jobs that failed are counted in ``seeds`` and left out of ``finished``; the mean is
            that of the jobs that were evaluated, None if none was.
    """
    groups: dict[tuple[tuple[str, str], ...], list[Mapping[str, Any]]] = {}
    for record in records:
        if SEED in record["settings"]:
            others = tuple((key, value) for key, value in record["settings"].items() if key != SEED)
            groups.setdefault(others, []).append(record)
    found = []
    for others, members in groups.items():
        rates = [each["success"] for each in members if each["success"] is not None]
        found.append(
            {
                "settings": dict(others),
                "seeds": len(members),
                "finished": sum(each["status"] == "finished" for each in members),
                "mean": statistics.fmean(rates) if rates else None,
                "least": min(rates, default=None),
                "greatest": max(rates, default=None),
            }
        )
    return found


def text(records: Sequence[Mapping[str, Any]]) -> str:
    """Return the tables of a sweep: a row for each job, then a row for each mean over seeds.

    Args:
        records: As for `document`.
    """
    keys = list(dict.fromkeys(key for record in records for key in record["settings"]))
    made = new_table("job", *_headings(keys), "success", "95 % interval", "steps", "run")
    for record in records:
        interval = _interval(record)
        made.add_row(
            str(record["number"]),
            *(record["settings"].get(key, "-") for key in keys),
            _success(record["success"], record["status"] == "finished"),
            "-" if interval is None else f"{interval[0]:.1%} to {interval[1]:.1%}",
            "-" if record["steps"] is None else format_count(record["steps"]),
            record["run"] or "-",
        )
    lines = [rendered(made)]
    means = over_seeds(records)
    if any(mean["seeds"] > 1 for mean in means):
        others = [key for key in keys if key != SEED]
        made = new_table(*_headings(others), "seeds", "mean success", "least to greatest")
        for mean in means:
            made.add_row(
                *(mean["settings"].get(key, "-") for key in others),
                str(mean["seeds"]) if mean["seeds"] == mean["finished"] else f"{mean['finished']} of {mean['seeds']}",
                _success(mean["mean"], mean["finished"] > 0),
                "-" if mean["mean"] is None else f"{mean['least']:.1%} to {mean['greatest']:.1%}",
            )
        lines.append(rendered(made))
    return "\n\n".join(lines)


def best(records: Sequence[Mapping[str, Any]]) -> Mapping[str, Any] | None:
    """Return the record with the highest success; None if no job has a result."""
    rated = [record for record in records if record["success"] is not None]
    return max(rated, key=lambda record: record["success"], default=None)


def _success(rate: float | None, finished: bool) -> str:
    if rate is None:
        return "not evaluated" if finished else "failed"
    return f"{rate:.1%}"


def _interval(record: Mapping[str, Any]) -> tuple[float, float] | None:
    if not record["episodes"] or not math.isfinite(record["success"]):
        return None
    return wilson_interval(record["successes"], record["episodes"])


def _headings(keys: Sequence[str]) -> list[str]:
    """Return the last parts of keys where they are unambiguous."""
    last = [key.rpartition(".")[2] for key in keys]
    return [short if last.count(short) == 1 else key for key, short in zip(keys, last)]
