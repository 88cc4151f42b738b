"""Tables of sweeps."""

from __future__ import annotations

from typing import Any

import pytest

from skatemount.evaluation.intervals import wilson_interval
from skatemount.evaluation.sweep_report import best, document, over_seeds, text


def record(number: int, settings: dict[str, str], successes: int | None, episodes: int = 100) -> dict[str, Any]:
    failed = successes is None
    return {
        "format": 1,
        "number": number,
        "status": "failed" if failed else "finished",
        "settings": settings,
        "success": None if successes is None else successes / episodes,
        "successes": successes,
        "episodes": None if failed else episodes,
        "steps": None if failed else 1000,
        "run": None if failed else f"run {number}",
        "error": "broken" if failed else None,
        "overrides": [],
    }


RECORDS = [
    record(1, {"algorithm.learning_rate": "1e-3", "seed": "0"}, 50),
    record(2, {"algorithm.learning_rate": "1e-3", "seed": "1"}, 70),
    record(3, {"algorithm.learning_rate": "1e-4", "seed": "0"}, None),
    record(4, {"algorithm.learning_rate": "1e-4", "seed": "1"}, 90),
]


def test_means_over_seeds_count_the_jobs_that_have_a_result() -> None:
    first, second = over_seeds(RECORDS)
    assert first == {
        "settings": {"algorithm.learning_rate": "1e-3"}, "seeds": 2, "finished": 2,
        "mean": pytest.approx(0.6), "least": 0.5, "greatest": 0.7,
    }  # fmt: skip
    assert (second["seeds"], second["finished"], second["mean"]) == (2, 1, 0.9)
    assert over_seeds([record(1, {"stage": "balance"}, 1)]) == []


def test_a_job_has_wilsons_interval() -> None:
    jobs = document(RECORDS)["jobs"]
    assert (jobs[0]["low"], jobs[0]["high"]) == wilson_interval(50, 100)
    assert jobs[2]["low"] is None and jobs[2]["error"] == "broken"


def test_tables_have_a_row_a_job_and_a_row_a_mean() -> None:
    lines = text(RECORDS).splitlines()
    assert lines[0].split() == ["job", "learning_rate", "seed", "success", "95", "%", "interval", "steps", "run"]
    assert lines[2].split() == ["1", "1e-3", "0", "50.0%", "40.4%", "to", "59.6%", "1.0k", "run", "1"]
    assert lines[4].split() == ["3", "1e-4", "0", "failed", "-", "-", "-"]
    assert lines[-2].split() == ["1e-3", "2", "60.0%", "50.0%", "to", "70.0%"]
    assert lines[-1].split() == ["1e-4", "1", "of", "2", "90.0%", "90.0%", "to", "90.0%"]
    assert len(text([record(1, {"seed": "0"}, 1)]).splitlines()) == 3  # one seed has no mean


def test_jobs_that_were_not_evaluated_say_so() -> None:
    jobs = [record(i, {"seed": str(i)}, 1) | {"success": None, "successes": None, "episodes": None} for i in (1, 2)]
    lines = [line.split() for line in text(jobs).splitlines()]
    assert lines[2] == ["1", "1", "not", "evaluated", "-", "1.0k", "run", "1"]
    assert lines[-1] == ["2", "not", "evaluated", "-"]
    assert text([*jobs, record(3, {"seed": "3"}, None)]).splitlines()[-1].split()[:3] == ["2", "of", "3"]
    failed = [record(i, {"seed": str(i)}, None) for i in (1, 2)]
    assert text(failed).splitlines()[-1].split() == ["0", "of", "2", "failed", "-"]


def test_the_best_is_the_highest_success() -> None:
    assert best(RECORDS) == RECORDS[3] and best(RECORDS[2:3]) is None
