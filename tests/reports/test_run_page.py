"""The page of a run, and of two runs."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import numpy as np
import pytest
from parsed_page import Page

from skatemount.config import compose_program
from skatemount.report import report
from skatemount.reports.facts import about_rows, differences, duration, short_names
from skatemount.reports.page import shown
from skatemount.reports.run_page import headline
from skatemount.reports.subjects import find_subject
from skatemount.reports.suites import AT_END, FOR_PAGE, merged, parse
from skatemount.runs.metrics import read_metrics

SECTIONS = ["about", "repeat", "settings", "suites", "episodes", "curves", "rewards", "compute", "code"]
QUIET = ["page.suites=[]", "page.films=0"]


def page(tmp_path: Path, *settings: str) -> Page:
    given = [*settings, f"output={tmp_path / 'sub' / 'r.html'}"]
    report(compose_program("report", given), given)
    found = Page((tmp_path / "sub" / "r.html").read_text(encoding="utf-8"))
    found.check_whole()
    return found


@pytest.fixture(scope="module")
def one(first: Path, tmp_path_factory: pytest.TempPathFactory) -> Page:
    return page(tmp_path_factory.mktemp("one"), f"run={first}", *QUIET)


def test_sections_and_the_command_that_repeats_it(one: Page, first: Path) -> None:
    assert list(one.sections) == SECTIONS
    subject = find_subject(str(first), first.parent)
    assert subject.command in one.sections["repeat"] and subject.commit in one.sections["repeat"]
    assert f"skatemount.evaluate checkpoint={subject.spec}" in one.sections["repeat"]
    assert f"# commit {subject.commit}" in one.sections["code"]
    assert one.row("stage")[1] == "balance" and one.row("seed")[1] == "0"
    assert shlex.join([f"run={first}"]) in one.text


def test_curves_hold_the_metrics(one: Page, first: Path) -> None:
    table = read_metrics(first / "metrics.jsonl")
    shown_metrics = {"KL divergence of an update": "Loss/kl", "learning rate": "Loss/learning_rate",
                     "environment steps a second": "Perf/total_fps"}  # fmt: skip
    for title, name in shown_metrics.items():
        (line,) = one.charts[title]["lines"]
        known = np.isfinite(table[name])
        np.testing.assert_allclose(line["x"], table["frames"][known])
        np.testing.assert_allclose(line["y"], table[name][known], rtol=1e-5)


def test_every_reward_term_has_weight_value_and_curve(one: Page, first: Path) -> None:
    table = read_metrics(first / "metrics.jsonl")
    terms = [name.removeprefix("Episode_Reward/") for name in table if name.startswith("Episode_Reward/")]
    assert len(terms) > 10
    weights = find_subject(str(first), first.parent).config["reward"]
    for term in terms:
        name, weight, value, *_ = one.row(term)
        values = table[f"Episode_Reward/{term}"]
        assert weight == f"{weights[term]['weight']:g}" and term in one.charts
        assert value == f"{values[np.isfinite(values)][-1]:+.4f}"


def test_settings_differ_from_the_defaults_of_the_stage(one: Page) -> None:
    assert "Settings of the logger are not compared" in one.sections["settings"]
    assert one.row("physics.num_worlds")[1:] == ["8", "1024"]
    assert one.row("network.actor")[1] == "[16]"
    # The second row of a setting is in the list of all of them.
    assert sum(row[0] == "robot.kp" for row in one.rows if row) == 1
    assert "defaults of stage=balance" in one.text


def test_results_in_the_runs_folder_and_what_it_took(one: Page, first: Path) -> None:
    found = json.loads((first / "evaluation.json").read_text())
    assert "balance (at the end of the training)" in one.sections["suites"]
    rate, low, high = (100 * found["success"][name] for name in ("rate", "low", "high"))
    assert f"{rate:.1f} %" in one.sections["suites"] and f"{low:.1f} to {high:.1f} %" in one.sections["suites"]
    assert one.row("torch threads")[1] == "1" and one.row("physics threads")[1] == "1"
    assert one.row("mujoco")[1] == find_subject(str(first), first.parent).environment["mujoco"]


def test_two_runs(first: Path, second: Path, tmp_path: Path) -> None:
    (tmp_path / "results").mkdir()
    for name in ("another", second.name):
        about = {"suite": "far", "checkpoint": f"{name}/step_1", "sha256": "0"}
        found = {"episodes": 9, "success": {"rate": 0.5, "low": 0.4, "high": 0.6}, "evaluated": about}
        (tmp_path / "results" / f"{name[:9]}.json").write_text(json.dumps(found))
    given = [f"run={first}", f"against={second}", f"page.results=[{tmp_path / 'results'}]", *QUIET]
    two = page(tmp_path, *given)
    assert list(two.sections) == SECTIONS
    # A name is text, whatever is in it.
    assert "img" not in two.elements and "second <img src=x>" in two.sections["about"]
    assert two.row("algorithm.learning_rate") == ["algorithm.learning_rate", "0.001", "0.0003"]
    assert two.row("seed")[1:] == ["0", "1"]
    lines = two.charts["KL divergence of an update"]["lines"]
    assert [line["label"] for line in lines] == ["first", "second <img src=x>"]
    table = read_metrics(second / "metrics.jsonl")
    np.testing.assert_allclose(lines[1]["y"], table["Loss/kl"], rtol=1e-5)
    # Results of a policy that is neither of them have a column of their own.
    assert two.row("suite")[1:] == ["first", "second <img src=x>", "another/step_1"]
    assert two.charts["success by suite"]["series"][-1] == "another/step_1"


def test_a_policy_without_a_run_and_a_run_without_a_policy(begun: Path, tmp_path: Path) -> None:
    shipped = page(tmp_path, "run=pretrained:approach", *QUIET)
    assert list(shipped.sections) == SECTIONS and "There are no curves" in shipped.sections["curves"]
    assert "approach-unfixed" in shipped.sections["suites"] and "Trained by: " in shipped.sections["repeat"]
    empty = page(tmp_path, f"run={begun}", "page.films=0")
    assert "has no checkpoint yet" in empty.sections["about"] and "no metrics were logged" in empty.sections["curves"]


def test_differences_name_what_one_side_lacks() -> None:
    ours = {"a": {"x": 1, "y": 2}, "reward": {"alive": {"weight": 1.0, "params": {}}}, "logger": {"name": "a"}}
    theirs = {"a": {"x": 1, "y": 3}, "reward": {}, "logger": {"name": "b"}}
    assert differences(ours, theirs) == [("a.y", "2", "3"), ("reward.alive", "weight 1", "–")]
    assert differences(ours, ours) == []


@pytest.mark.parametrize(
    ("seconds", "text"), [(3, "3 s"), (59.7, "1 min"), (3599, "1 h 00 min"), (6360, "1 h 46 min"), (float("nan"), "–")]
)
def test_times_in_words(seconds: float, text: str) -> None:
    assert duration(seconds) == text


def test_short_names_stay_different() -> None:
    day = "2026-11-29_08-46-15_"
    assert short_names([f"{day}a", f"{day}b"]) == ["a", "b"]
    assert short_names([f"{day}a", "2026-11-30_08-46-15_a"]) == [f"{day}a", "2026-11-30_08-46-15_a"]
    assert short_names(["a", "a"]) == ["a", "a (2)"]


def test_values_are_written_as_on_a_command_line() -> None:
    values = [None, True, 1.0, 1e-5, [1.0, "a"], "", {}]
    assert [shown(value) for value in values] == ["null", "true", "1", "1e-05", "[1, a]", "''", "{}"]


def test_the_result_at_the_top_is_that_of_the_training(root: Path) -> None:
    subject = find_subject("pretrained:unfixed", root)
    results = merged(parse({"suites": subject.card.suites}, "card"))
    assert next(iter(results)) == "gait" and headline(subject, results).name == "approach-unfixed"
    assert headline(subject, {}) is None
    both = {f"unfixed ({when})": results["gait"] for when in (AT_END, FOR_PAGE)}
    assert headline(subject, both | results) is both[f"unfixed ({FOR_PAGE})"]
    assert headline(subject, results | {f"unfixed ({AT_END})": results["far"]}) is results["far"]
    robust = find_subject("pretrained:robust", root)
    found = merged(parse({"suites": robust.card.suites}, "card"))
    # No suite is of its own stage.
    assert next(iter(found)) == "gait" and headline(robust, found).name == "approach-unfixed"
    del found["approach-unfixed"]
    assert headline(robust, found).name == "balance-fixed"
    assert headline(robust, {"gait": found["gait"]}).name == "gait"
    assert dict(about_rows([subject]))["started from"] == ["scratch"]
    assert dict(about_rows([find_subject("pretrained:anywhere", root)]))["started from"][0].startswith("pretrained:")
