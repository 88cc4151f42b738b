"""Results of an evaluation as numbers, JSON and text."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest
import torch

from skatemount.envs.tasks import TASKS
from skatemount.evaluation import report
from skatemount.evaluation.records import EpisodeRecords
from skatemount.evaluation.results import Evaluation

MOUNT = TASKS.get("mount")
ENDS = ["not_mounted", "trunk_contact", "tilt"]
Make = Callable[..., EpisodeRecords]


def test_results_as_json_and_as_a_table(make_records: Make) -> None:
    records = make_records(20, end=[2] * 5 + [0] * 15, feet_on_board=[1.5] * 20, slips=[0, 3] * 10, energy=range(20))
    result = Evaluation(
        records, ENDS, MOUNT, evaluated={"checkpoint": "a/b", "suite": "far", "definition": {"version": 3}}
    )
    document = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert document["episodes"] == 20
    assert document["success"] == pytest.approx({"rate": 0, "low": 0, "high": 0.1611}, abs=5e-5)
    assert document["time_to_mount"] == {"median": None, "p95": None}
    assert (document["slips"], document["energy"], document["feet_on_board"]) == (1.5, 9.5, 1.5)
    assert document["failures"] == {"not_mounted": 15, "tilt": 5}
    assert "failed_episodes" not in result.to_dict(failed_episodes=False) and "variants" not in document
    text = report.table(result)
    for part in (
        "a/b on far, version 3",
        "0.0% (95 % interval 0.0% to 16.1%)",
        "20: not mounted at the time limit 15, robot fell 5",
        "1.50 an episode",
        "10 J an episode",
    ):
        assert part in text, text
    assert "trunk" not in text


def test_quantiles(make_records: Make) -> None:
    times = [*range(1, 102), *[torch.nan] * 99]
    records = make_records(
        200, success=[1] * 101 + [0] * 99, time_to_mount=times, board_displacement=[0.0] * 150 + [1.0] * 50
    )
    result = Evaluation(records, ENDS, MOUNT)
    assert result.to_dict()["time_to_mount"] == {"median": 51.0, "p95": 96.0}
    assert result.to_dict()["board_displacement"] == {"median": 0.0, "p95": 1.0}
    assert result.metrics()["Evaluation/time_to_mount"] == 51.0


def test_failed_episodes_are_listed_with_their_starts(make_records: Make) -> None:
    records = make_records(
        4,
        success=[1, 0, 1, 0],
        end=[0, 1, 0, 0],
        start=[[0, 0, 0], [0.5, -0.25, 3.0], [0, 0, 0], [0.125, 0, -1.0]],
        duration=[5, 1.24, 5, 5],
        variant=[0, 1, 0, 1],
    )
    result = Evaluation(records, ENDS, MOUNT, variants=["usual", "odd"])
    first, second = result.failed_episodes()
    assert first == {
        "episode": 1,
        "variant": "odd",
        "start": {"x": 0.5, "y": -0.25, "yaw": 3.0},
        "board_fixed": True,
        "ended_by": "trunk_contact",
        "ended_after": 1.24,
    }
    assert (second["episode"], second["ended_by"]) == (3, "not_mounted")
    text = report.failed_episodes(result, most=1)
    assert (
        "+0.50 m" in text
        and "-0.25 m" in text
        and "+172°" in text
        and "trunk touched something" in text
        and "odd" in text
    )
    assert text.endswith("and 1 more") and "+0.12 m" not in text
    assert result.first_success() == 0


def test_no_failures_are_no_list(make_records: Make) -> None:
    result = Evaluation(make_records(3, success=[1, 1, 1]), ENDS, MOUNT)
    assert report.failed_episodes(result) == ""
    assert Evaluation(make_records(3), ENDS, MOUNT).first_success() is None
    assert (result.failures(), report.failures(result)) == ({}, "none")


def test_variants_get_a_row_each_and_the_total_counts_all(make_records: Make) -> None:
    records = make_records(6, variant=[0, 1, 0, 1, 0, 1], success=[1, 0, 1, 0, 1, 1], end=[0, 2, 0, 0, 0, 0])
    result = Evaluation(records, ENDS, MOUNT, variants=["usual", "odd", "never run"])
    document = result.to_dict()
    assert {name: part["success"]["rate"] for name, part in document["variants"].items()} == {
        "usual": 1.0,
        "odd": pytest.approx(1 / 3),
    }
    assert document["success"]["rate"] == pytest.approx(4 / 6)
    lines = {line.split("  ")[0].strip(): line for line in report.table(result).splitlines() if line.strip()}
    assert "100.0%" in lines["usual"] and "33.3%" in lines["odd"] and "66.7%" in lines["all of them"]
    assert "of 3" in lines["odd"]


def test_next_commands_are_a_line_each_with_their_purpose() -> None:
    text = report.next_commands({"film a failure": "record episode=3", "film the first success": "record episode=0"})
    assert text.splitlines() == [
        "film a failure:         record episode=3",
        "film the first success: record episode=0",
    ]
    assert report.next_commands({}) == ""


def test_the_title_says_what_is_unusual(make_records: Make) -> None:
    def title(**evaluated: Any) -> str:
        return Evaluation(make_records(1), ENDS, MOUNT, evaluated=evaluated).title

    assert title(checkpoint="best", suite="far", task="mount", robot="a1") == "best on far"
    assert title(checkpoint="best", suite="gait", task="gait", robot="go2") == "best on gait, robot go2"
    assert title(task="hold", robot="a1") == "evaluation, task hold"
    changed = title(checkpoint="best", suite="far", changed_by=["board=mini"], robot="go2")
    assert changed == "best on far, robot go2, changed by board=mini"


def test_the_worst_of_several_boards_is_told(make_records: Make) -> None:
    # Episode i is on board i modulo 5; board 4 has one episode, 3 has none.
    success = [1, 1, 0, 1, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1]
    records = make_records(14, success=success)
    keep = torch.arange(14) % 5 != 3
    result = Evaluation(records[keep], ENDS, MOUNT, boards=5)
    # Boards 0, 1, 2 and 4 succeed in 3 of 3, 2 of 3, 1 of 3 and 1 of 2.
    document = json.loads(json.dumps(result.to_dict(), allow_nan=False))["boards"]
    assert (document["number"], document["worst"]["board"], document["worst"]["episodes"]) == (5, 2, 3)
    assert document["worst"]["success"]["rate"] == pytest.approx(1 / 3)
    assert "worst of 5 boards" in report.table(result) and "board 2, 1 of 3 episodes" in report.table(result)
    usual = Evaluation(records, ENDS, MOUNT)
    assert "boards" not in usual.to_dict() and "boards" not in report.table(usual)
