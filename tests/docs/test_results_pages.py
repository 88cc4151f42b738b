"""Numbers on the pages are those of the results files, and nowhere else."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from scripts import load_script

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def write_results() -> ModuleType:
    return load_script("tools/write_results.py")


def evaluation(suite: str = "mount-fixed", successes: int = 3, episodes: int = 4) -> dict[str, Any]:
    """An evaluation as `python -m skatemount.evaluate` writes it."""
    return {
        "episodes": episodes,
        "success": {"rate": successes / episodes, "low": 0.3006, "high": 0.9544},
        "time_to_mount": {"median": 0.5, "p95": 0.7},
        "feet_on_board": 3.25,
        "failures": {"tilt": episodes - successes},
        "failed_episodes": [{"episode": 2}],
        "evaluated": {
            "checkpoint": "latest",
            "sha256": "abc",
            "suite": suite,
            "seed": 0,
            "overrides": ["board=mini"],
            "definition": {"version": 2, "stage": "mount", "description": "a test", "seed": 7},
            "versions": {"skatemount": "0.1.0", "mujoco": "3", "torch": "2"},
            "record": f"python -m skatemount.record checkpoint=latest suite={suite} board=mini episode=<episode>",
        },
    }


def test_pages_show_the_numbers_of_the_results_files(write_results: ModuleType) -> None:
    marked = 0
    for page in write_results.pages():
        text = page.read_text(encoding="utf-8")
        marked += len(write_results.MARK.findall(text))
        assert write_results.filled(text) == text, f"{page}: run python tools/write_results.py --fill"
    assert marked >= 10


def test_a_changed_number_is_noticed(write_results: ModuleType) -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    changed, count = re.subn(r"(approach-unfixed/success -->)[\d.]+", r"\g<1>12.3", text)
    assert count
    assert write_results.filled(changed) == text


def test_pages_for_users_have_no_success_rates_of_their_own(write_results: ModuleType) -> None:
    # Decisions and experiments keep the numbers of their time.
    for page in write_results.pages():
        if {"decisions", "experiments"} & set(page.parts):
            continue
        text = write_results.MARK.sub("", page.read_text(encoding="utf-8"))
        # The output of a command is that of its example.
        text = re.sub(r"^```\w+$.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)
        assert not re.findall(r"\d\.\d ?%", text), page


def test_a_comment_within_a_sentence_does_not_begin_a_line(write_results: ModuleType) -> None:
    # Markdown would take the line for HTML, which ends the paragraph.
    for page in write_results.pages():
        for line in page.read_text(encoding="utf-8").splitlines():
            assert not re.match(r"\s*<!-- result \S+ -->.", line), f"{page}: {line}"


def test_a_results_file_can_be_repeated(write_results: ModuleType) -> None:
    files = sorted(write_results.RESULTS.glob("*.json"))
    assert files
    for file in files:
        results = json.loads(file.read_text(encoding="utf-8"))
        if "suites" not in results:
            # No evaluation; its script and its table have tests of their own.
            assert results["command"].startswith("python benchmarks/") and results["versions"]["skatemount"]
            continue
        assert results["command"].startswith("python -m skatemount.evaluate checkpoint=")
        assert re.fullmatch(r"[0-9a-f]{7,40}", results["commit"]), "a results file comes from a clean commit"
        assert results["versions"]["skatemount"] and results["seed"] >= 0
        for name, suite in results["suites"].items():
            rate, episodes = suite["success"]["rate"], suite["episodes"]
            assert suite["success"]["low"] <= rate <= suite["success"]["high"], name
            assert sum(suite["failures"].values()) == round((1 - rate) * episodes), name


def test_results_are_of_the_shipped_weights(write_results: ModuleType) -> None:
    cards = (ROOT / "skatemount" / "policies").glob("*.json")
    shipped = {json.loads(card.read_text(encoding="utf-8"))["sha256"] for card in cards}
    for file in write_results.RESULTS.glob("*.json"):
        results = json.loads(file.read_text(encoding="utf-8"))
        if results.get("checkpoint", "").startswith("pretrained:"):
            assert results["sha256"] in shipped, file


def test_what_is_kept_of_an_evaluation(write_results: ModuleType) -> None:
    kept = write_results.condensed(evaluation(), "1234567")
    assert kept["command"] == (
        "python -m skatemount.evaluate checkpoint=latest suite=mount-fixed episodes=4 board=mini"
    )
    assert kept["commit"] == "1234567"
    assert kept["suites"]["mount-fixed"]["version"] == 2
    assert "failed_episodes" not in kept["suites"]["mount-fixed"]


def ladder(rates: dict[str, float]) -> dict[str, Any]:
    """An evaluation whose variants are steps, in the form of a results file."""
    parts = {name: {"success": {"rate": rate, "low": rate - 0.05, "high": rate}} for name, rate in rates.items()}
    steps = [{"name": name, "episodes": 40, **each["success"]} for name, each in parts.items()]
    both = {"success": {"rate": 0.5, "low": 0.4, "high": 0.6}, "variants": parts, "version": 1}
    return both | {"ladder": {"quantity": "delay", "unit": "ms", "steps": steps}}


def test_two_files_side_by_side(write_results: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(write_results, "RESULTS", tmp_path)
    far = {"success": {"rate": 0.75, "low": 0.7, "high": 0.8}, "version": 2}
    boards = {"variants": ladder({"penny": 0.2, "long": 0.9})["variants"], **far}
    old = {"checkpoint": "pretrained:old", "suites": {"far": far, "delay": ladder({"0ms": 0.9, "20ms": 0.1})}}
    new = {"checkpoint": "new", "suites": {"delay": ladder({"0ms": 1.0, "20ms": 0.8}), "boards": boards, "far": far}}
    for name, results in (("old", old), ("new", new)):
        (tmp_path / f"{name}.json").write_text(json.dumps(results), encoding="utf-8")
    assert write_results.look_up("new+old/compared").strip().splitlines() == [
        "| suite | variant | new | old |",
        "|---|---|---|---|",
        "| `delay` | 0ms | 100.0 % (95.0 to 100.0 %) | 90.0 % (85.0 to 90.0 %) |",
        "| `delay` | 20ms | 80.0 % (75.0 to 80.0 %) | 10.0 % (5.0 to 10.0 %) |",
        "| `boards` |  | 75.0 % (70.0 to 80.0 %) | – |",
        "| `boards` | the worst one | 20.0 % (15.0 to 20.0 %), penny | – |",
        "| `far` |  | 75.0 % (70.0 to 80.0 %) | 75.0 % (70.0 to 80.0 %) |",
    ]
    write_results.draw_ladders(["new", "old"], tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    old["suites"]["far"] = far | {"version": 1}
    with pytest.raises(ValueError, match=r"far: new and old have results of its versions \[1, 2\]"):
        write_results.compared(new, old)
    del old["suites"]["delay"]
    (tmp_path / "old.json").write_text(json.dumps(old), encoding="utf-8")
    with pytest.raises(ValueError, match=r"old\.json has no ladder"):
        write_results.draw_ladders(["new", "old"], tmp_path / "a.png")


def test_a_command_names_a_shipped_policy_by_its_name_of_today(write_results: ModuleType) -> None:
    old = {"command": "python -m skatemount.evaluate checkpoint=pretrained:best suite=all init=pretrained:bestest"}
    assert "checkpoint=pretrained:anywhere suite=all init=pretrained:bestest" in write_results.command(old)


def test_the_table_has_every_suite(write_results: ModuleType) -> None:
    gait = evaluation("gait", 0)
    gait["failures"] = {"not_followed": 3, "tilt": 1}
    gait["evaluated"]["definition"] = {"version": 1, "stage": "gait", "description": "walk"}
    table = write_results.table(
        write_results.condensed({"suites": {"gait": gait, "far": evaluation("far")}}, "1234567")
    )
    assert "| `gait` | 0.0 % | 30.1 to 95.4 % | – | – | did not follow the command 3, robot fell 1 |" in table
    assert "| `far` | 75.0 %" in table


def test_several_suites_are_one_command(write_results: ModuleType) -> None:
    both = {"suites": {"mount-fixed": evaluation(), "mount-unfixed": evaluation("mount-unfixed", 1)}}
    kept = write_results.condensed(both, "1234567")
    assert "suite=all" in kept["command"]
    assert kept["suites"]["mount-unfixed"]["success"]["rate"] == 0.25


def test_values_and_tables_as_text(write_results: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(write_results, "RESULTS", tmp_path)
    kept = write_results.condensed(evaluation(), "1234567")
    (tmp_path / "mine.json").write_text(json.dumps(kept), encoding="utf-8")
    page = (
        "<!-- result mine/mount-fixed/success -->old<!-- end -->, <!-- result mine/mount-fixed/interval --><!-- end -->"
    )
    assert write_results.filled(page) == (
        "<!-- result mine/mount-fixed/success -->75.0 %<!-- end -->, "
        "<!-- result mine/mount-fixed/interval -->30.1 to 95.4 %<!-- end -->"
    )
    table = write_results.look_up("mine/table")
    assert "| `mount-fixed` | 75.0 % | 30.1 to 95.4 % | 0.50 s | 3.25 | robot fell 1 |" in table
    with pytest.raises(KeyError):
        write_results.look_up("mine/no-such-suite/success")
