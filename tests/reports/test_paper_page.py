"""The page of the paper."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from parsed_page import Page

from skatemount.config import compose
from skatemount.reports.paper_page import DATA, paper_page, results_dir, shipped_results
from skatemount.reports.subjects import find_subject

SECTIONS = ["about", "stages", "results", "curves", "points", "rewards", "settings", "suites"]


@pytest.fixture(scope="module")
def page() -> Page:
    found = Page(paper_page(None, "the command", strip=("six", b"\xff\xd8")))
    found.check_whole()
    return found


def test_sections_and_sources(page: Page) -> None:
    assert list(page.sections) == SECTIONS
    assert "arXiv 2505.06561" in page.sections["about"]
    assert ("img", "src", "data:image/jpeg;base64,/9g=") in page.addresses


def test_results_are_those_that_are_shipped(page: Page) -> None:
    results = shipped_results()
    assert list(results)[0] == "pretrained:anywhere"
    document = json.loads((results_dir() / "anywhere.json").read_text())["suites"]
    values = {row["label"]: row["values"][0] for row in page.charts["success by suite"]["rows"]}
    assert {suite: values[suite][0] for suite in document} == {
        suite: found["success"]["rate"] for suite, found in document.items()
    }
    assert f"{100 * document['far']['success']['rate']:.1f} %" in page.sections["suites"]
    labels = [row["label"] for row in page.charts["success by suite"]["rows"]]
    assert sorted(labels) == sorted({suite for column in results.values() for suite in column})
    assert page.charts["other-boards, by variant"]["rows"][0]["label"] == "longboard"
    # Not the path of this machine.
    assert {result.source for result in results["pretrained:anywhere"].values()} == {"docs/results/anywhere.json"}
    assert str(results_dir()) not in page.text


def test_the_papers_curves_are_its_own(page: Page) -> None:
    paper = json.loads(DATA.read_text())
    curve = paper["balance"]["Episode_Reward/skate_feet_contact"]["curve"]
    line = page.charts["feet on the deck, of 4"]["lines"][0]
    assert len(line["x"]) == 50 and line["x"][0] == 0 and line["x"][-1] == pytest.approx(212 * 4096 * 24, rel=1e-5)
    assert line["y"][-1] == pytest.approx(curve[-1][1] / 5) and 2.1 < line["y"][-1] < 2.4
    shipped = find_subject("pretrained:balance", "runs")
    ours = page.charts["feet on the deck, of 4"]["lines"][1]
    assert ours["y"][0] == pytest.approx(shipped.final("Success/feet_on_board"), rel=1e-5)


def test_settings_are_todays(page: Page) -> None:
    usual, theirs = compose("unfixed"), compose("unfixed", ["experiment=paper"])
    assert page.row("robot.kp")[1:] == [f"{theirs.robot.kp:g}", f"{usual.robot.kp:g}"]
    assert page.row("joint gains")[2] == f"kp {usual.robot.kp:g}, kd {usual.robot.kd:g}"
    assert page.row("board_flip")[1:] == [
        f"{each.reward['board_flip'].weight:g}" for each in (theirs, usual)
    ]  # fmt: skip


def test_a_run_stands_beside_the_paper(first: Path) -> None:
    page = Page(paper_page(find_subject(str(first), first.parent), "the command"))
    page.check_whole()
    lines = page.charts["standard deviation of the actions"]["lines"]
    assert [line["label"] for line in lines] == ["paper", first.name]
