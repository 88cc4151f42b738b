"""Results of evaluations, from whatever file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from skatemount.reports.suites import (
    AT_END,
    OWN_TASK,
    merged,
    parse,
    read_results,
    results_in,
    suite_charts,
    suite_rows,
    variant_figures,
)
from skatemount.utils.errors import ConfigError


def result(rate: float, **more: Any) -> dict[str, Any]:
    return {
        "episodes": 100,
        "success": {"rate": rate, "low": rate - 0.05, "high": rate + 0.05},
        "failures": {"tilt": 3, "not_mounted": 2},
        **more,
    }


def ladder(*rates: float) -> dict[str, Any]:
    return result(0.9, variants={f"{0.5 * (i + 1):g} m/s": result(rate) for i, rate in enumerate(rates)})


def test_one_evaluation_several_and_a_file_of_the_docs() -> None:
    about = {"suite": "far", "checkpoint": "a/step_1", "sha256": "ab", "definition": {"version": 2, "description": "d"}}
    (one,) = parse(result(0.5, evaluated=about), "f")
    assert (one.name, one.version, one.description, one.policy) == ("far", "2", "d", ("a/step_1", "ab"))
    assert one.rate == (0.5, 0.45, 0.55) and one.failures == {"robot fell": 3, "not mounted at the time limit": 2}
    (changed,) = parse(result(0.5, evaluated=about | {"changed_by": ["board=mini"]}), "f")
    assert changed.name == "far, changed by board=mini"  # a row of its own, beside that of the suite
    (own,) = parse(result(0.5), "f")
    assert own.name == OWN_TASK and own.policy == ("", "")
    docs = {"checkpoint": "pretrained:x", "sha256": "cd", "suites": {"far": result(0.4, version=3)}}
    (far,) = parse(docs, "f")
    assert (far.version, far.policy) == ("3", ("pretrained:x", "cd"))


@pytest.mark.parametrize("document", [{}, [], {"success": 0.5, "episodes": 1}, {"suites": {"a": {"episodes": 3}}}, 3])
def test_other_documents_are_refused_in_one_line(document: Any) -> None:
    with pytest.raises(ConfigError, match="^f: ") as error:
        parse(document, "f")
    assert "\n" not in str(error.value)


def test_metrics_have_the_labels_of_their_task() -> None:
    more = {"time_to_mount": {"median": 0.8, "p95": 1.5}, "feet_on_board": 3.9}
    (one,) = parse(result(0.5, **more), "f")
    assert one.main_metrics() == "time to mount 0.80 s, feet on board 3.90"
    assert "time to mount median 0.80 s" in one.metrics()
    assert parse(result(0.5), "f")[0].main_metrics() == ""


def test_files_and_folders(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(json.dumps(result(0.5, evaluated={"suite": "far"})))
    (tmp_path / "b.json").write_text(json.dumps({"suites": {"gait": result(0.1)}}))
    found = read_results([str(tmp_path)])
    assert [(each.name, Path(each.source).name) for each in found] == [("far", "a.json"), ("gait", "b.json")]
    (tmp_path / "c.json").write_text("{")
    for given, expected in (
        (tmp_path, "c.json is not JSON"),
        (tmp_path / "none.json", "cannot be read"),
    ):
        with pytest.raises(ConfigError, match=f"page.results={given}: .*{expected}"):
            read_results([str(given)])
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(ConfigError, match="has no .*json file"):
        read_results([str(empty)])
    # A run's folder has other JSON as well.
    assert [each.name for each in results_in(tmp_path)] == ["far", "gait"]


def test_the_parts_of_a_chain_keep_their_results(tmp_path: Path) -> None:
    for part in ("1_gait", "10_hold", "2_balance"):
        (tmp_path / part).mkdir()
        (tmp_path / part / "evaluation.json").write_text(json.dumps(result(0.5, frames=4096)))
    (tmp_path / "stages.json").write_text(json.dumps({"stages": []}))
    found = results_in(tmp_path)
    assert [each.name for each in found] == [f"{part} ({AT_END})" for part in ("10_hold", "2_balance", "1_gait")]
    (tmp_path / "evaluation.json").write_text(json.dumps(result(0.5)))
    assert results_in(tmp_path, "hold")[0].name == f"hold ({AT_END})"
    assert found[0].source == "10_hold/evaluation.json, after 4,096 steps"


def test_the_first_of_the_same_suite_counts() -> None:
    newer, older = parse(result(0.9), "new"), parse(result(0.1), "old")
    assert merged(newer, older)[OWN_TASK].source == "new"


def test_a_ladder_says_where_it_falls() -> None:
    columns = {
        "ours": {"pushes": parse({"suites": {"pushes": ladder(0.99, 0.95, 0.6, 0.2)}}, "f")[0]},
        "theirs": {"pushes": parse({"suites": {"pushes": ladder(0.99, 0.95, 0.92, 0.91)}}, "f")[0]},
    }
    # An older version of the suite had no steps.
    columns["before"] = {"pushes": parse({"suites": {"pushes": result(0.5)}}, "f")[0]}
    (chart,) = variant_figures(columns)
    assert chart.title == "ladder pushes"
    assert [label for _, label in chart.legend][-2:] == ["ours", "theirs"] and "before" not in chart.note
    assert "ours falls below 90% at 1.5 m/s." in chart.note and "theirs holds 90% to the end." in chart.note
    lines = json.loads(chart.data)["lines"]
    assert lines[1] == {"label": "ours", "color": 0, "faint": False} | {
        "x": [0.5, 1.0, 1.5, 2.0], "y": [0.99, 0.95, 0.6, 0.2]
    }  # fmt: skip
    assert ">m/s</text>" in chart.svg


@pytest.mark.parametrize(
    "names", [["longboard", "penny", "heavier"], ["1 m", "2 s", "3 m"], ["1 m", "3 m", "2 m"], ["1 m", "2 m"]]
)
def test_other_variants_are_rows(names: list[str]) -> None:
    document = result(0.5, variants={name: result(0.5) for name in names})
    (chart,) = variant_figures({"ours": {"boards": parse({"suites": {"boards": document}}, "f")[0]}})
    assert [row["label"] for row in json.loads(chart.data)["rows"]] == names


def test_rows_and_charts_of_several_policies() -> None:
    columns = {"a": merged(parse({"suites": {"far": result(0.5), "gait": result(0.1)}}, "f")),
               "b": merged(parse({"suites": {"far": result(0.7)}}, "g"))}  # fmt: skip
    far, gait = suite_rows(columns)
    assert [each and each[0][0] for each in far["rates"]] == [0.5, 0.7] and gait["rates"][1] is None
    assert [chart.title for chart in suite_charts(columns)] == ["success by suite"]
    assert suite_charts({"a": columns["a"]}) == []
