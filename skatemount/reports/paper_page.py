"""The page of the paper: its tables and curves beside this project's, from what the package ships."""

from __future__ import annotations

import datetime
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from skatemount.config import compose, to_dict
from skatemount.reports.charts import Chart, Line, line_chart, line_of
from skatemount.reports.curves import REWARD, TERMINATION, percent
from skatemount.reports.facts import differences, duration
from skatemount.reports.page import render, shown
from skatemount.reports.subjects import Stage, Subject, flat, read_policy
from skatemount.reports.suites import (
    Result,
    measured_rows,
    merged,
    parse,
    read_results,
    suite_charts,
    suite_rows,
)
from skatemount.runs.shipped import shipped_file
from skatemount.utils.formatting import format_count

DATA = Path(__file__).parent / "paper.json"
"""Facts and curves of the paper, with their source."""

OURS = {
    "gait": ("gait", "gait"),
    "balance": ("balance", "balance-fixed"),
    "mount": ("mount", "mount-fixed"),
    "approach": ("approach", "approach-fixed"),
    "unfixed": ("unfixed", "approach-unfixed"),
}
"""Shipped policy and suite of each of the paper's stages."""

SHOWN = ("unfixed", "approach")
"""Shipped policies whose suites stand beside those of the results files: the paper's last stage and its claim."""

STAGE = "unfixed"
"""Stage whose settings are compared."""

STRIP = ("pretrained:anywhere", "approach-unfixed")
"""Policy and suite of the strip of six moments."""

REWARDS = {
    "skate_feet_contact": "feet_on_board",
    "skate_distance_tracking": "distance",
    "skate_orientation_tracking": "alignment",
}
"""Reward terms of the paper and those of this project that stand in their place."""


def results_dir() -> Path | None:
    """Return the folder of the shipped results: inside the package in a wheel, in the docs of a clone."""
    package = Path(__file__).resolve().parents[1]
    folders = (package / "results", package.parent / "docs" / "results")
    return next((folder for folder in folders if folder.is_dir()), None)


def shipped_results() -> dict[str, dict[str, Result]]:
    """Return the results of MountBench by policy: those of the results files, then those on cards."""
    found: dict[str, dict[str, Result]] = {}
    folder = results_dir()
    for file in sorted(folder.glob("*.json")) if folder is not None else []:
        # Other files hold measurements of other kinds.
        if "suites" in json.loads(file.read_bytes()):
            results = read_results([str(file)])
            for result in results:
                # Its name in the source tree; the path is that of one machine.
                result.source = f"docs/results/{file.name}"
            found[results[0].policy[0] or file.stem] = {result.name: result for result in results}
    for name in SHOWN:
        policy = _shipped(name)
        assert policy.card is not None
        found[policy.name] = merged(parse({"suites": policy.card.suites}, f"card of {policy.name}"))
    return {name: results for name, results in found.items() if len(results) > 1}


def paper_page(
    run: Subject | None, command: str, results: Sequence[Result] = (), strip: tuple[str, bytes] | None = None
) -> str:
    """Return the page.

    Args:
        run: A run whose curves stand beside the paper's; None shows the end of `pretrained:balance` instead.
        command: Command that writes it.
        results: Results to show beside the shipped ones.
        strip: Caption and JPEG of six moments of an episode, for the paper's figure 3; None for none.
    """
    paper = json.loads(DATA.read_text(encoding="utf-8"))
    columns = shipped_results()
    for result in results:
        columns.setdefault(result.policy[0] or result.source, {}).setdefault(result.name, result)
    usual, theirs = compose(STAGE), compose(STAGE, ["experiment=paper"])
    groups = _by_group(differences(to_dict(theirs), to_dict(usual)))
    context = {
        "title": "The paper beside this project",
        "subtitle": "Quadrupedal Robot Skateboard Mounting via Reverse Curriculum Learning, point by point",
        "kind": "report of the paper",
        "made": f"{datetime.datetime.now():%Y-%m-%d %H:%M}",
        "command": command,
        "source": paper["source"],
        "missing": paper["missing"],
        "stages": _stage_rows(paper),
        "steps": format_count(_steps(paper, 9898)),
        "feet_chart": _feet_chart(paper, columns),
        "replica": paper["replica"],
        "ours_feet": _ours_feet(columns),
        "curves": _balance_charts(paper, run),
        "curves_ours": run.name if run is not None else "pretrained:balance",
        "has_run": run is not None,
        "terms": _terms(paper),
        "development": _development(paper),
        "points": _points(paper, flat(to_dict(usual)), to_dict(usual)),
        "rewards": _reward_rows(to_dict(theirs), to_dict(usual)),
        "groups": groups,
        "count": sum(len(rows) for _, rows in groups),
        "suites": suite_rows(columns),
        "columns": list(columns),
        "measured": measured_rows(columns),
        "suite_charts": suite_charts(columns),
        "strip": strip,
    }
    return render("paper.html.jinja", context)


def _shipped(name: str) -> Subject:
    file = shipped_file(name)
    assert file is not None
    return read_policy(file)


def _steps(paper: Mapping[str, Any], iterations: float) -> float:
    return iterations * paper["worlds"] * paper["steps_per_iteration"]


def _stage_rows(paper: Mapping[str, Any]) -> list[dict[str, Any]]:
    rows = []
    for stage in paper["stages"]:
        iterations, name = stage["iterations"], stage["name"]
        row = {
            "name": name,
            "about": stage["about"],
            "log": stage["log"],
            "paper": "–" if iterations is None else format_count(_steps(paper, iterations[1] - iterations[0])),
            "iterations": "–" if iterations is None else f"{iterations[0]:,} to {iterations[1]:,}",
            "policy": "",
            "ours": "–",
            "suite": "",
            "rate": None,
        }
        if name in OURS:
            policy, suite = OURS[name]
            subject = _shipped(policy)
            assert subject.card is not None
            (result,) = parse({"suites": {suite: subject.card.suites[suite]}}, f"card of {subject.name}")
            row |= {"policy": subject.name, "suite": suite, "rate": result.rate}
            took = f", {duration(subject.seconds)}" if math.isfinite(subject.seconds) else ""
            row["ours"] = format_count(subject.frames) + took
        rows.append(row)
    return rows


def _ours_feet(columns: Mapping[str, Mapping[str, Result]]) -> list[tuple[str, str, float, tuple[float, float, float]]]:
    """Return policy, suite, feet on the deck and success of each result that has them."""
    return [
        (name, suite, float(result.document["feet_on_board"]), result.rate)
        for name, results in columns.items()
        for suite, result in results.items()
        if "feet_on_board" in result.document
        and suite in ("balance-fixed", "mount-fixed", "approach-fixed", "mount-unfixed", "approach-unfixed")
    ]


def _feet(paper: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Return iterations and feet on the deck of the paper's log: its reward is the weight for each foot."""
    curve = np.array(paper["balance"][f"{REWARD}skate_feet_contact"]["curve"])
    return curve[:, 0], curve[:, 1] / paper["feet_weight"]


def _feet_chart(paper: Mapping[str, Any], columns: Mapping[str, Mapping[str, Result]]) -> Chart | None:
    iterations, feet = _feet(paper)
    steps = _steps(paper, 1) * (iterations - iterations[0])
    lines: list[Line | None] = [Line("paper, balance, while it trains", steps, feet, 0)]
    found = [row for row in _ours_feet(columns) if row[1] in ("balance-fixed", "approach-unfixed")]
    for i, (name, suite, value, _) in enumerate(found[:4], 1):
        lines.append(Line(f"{name} on {suite}", steps[[0, -1]], np.array([value, value]), i, dashed=True))
    return line_chart(
        "feet on the deck, of 4", lines, limits=(0.0, 4.1),
        x_label="environment steps of the paper's published log",
    )  # fmt: skip


def _balance_charts(paper: Mapping[str, Any], run: Subject | None) -> list[Chart]:
    """Return the curves of the paper's published log, with those of a run, or the end of `pretrained:balance`."""
    balance, first = paper["balance"], _shipped("balance")
    episode = to_dict(compose("balance"))

    def chart(title: str, tag: str, scale: float, ours: str, our_scale: float, **options: Any) -> Chart | None:
        curve = np.array(balance[tag]["curve"])
        steps = _steps(paper, 1) * (curve[:, 0] - curve[0, 0])
        lines: list[Line | None] = [Line("paper", steps, scale * curve[:, 1], 0)]
        stage = _last_stage(run)
        if stage is not None:
            line = line_of(run.name if run else "", stage.steps, stage.table.get(ours), 1)
            if line is not None:
                parts = (line.y, line.low, line.high)
                line.y, line.low, line.high = (None if each is None else our_scale * each for each in parts)  # type: ignore[assignment]
            lines.append(line)
        elif (value := first.final(ours)) is not None:
            lines.append(Line("pretrained:balance, at its end", steps[[0, -1]],
                              our_scale * np.array([value, value]), 1, dashed=True))  # fmt: skip
        return line_chart(title, lines, **options)

    control_steps = episode["episode_length"] / (episode["physics"]["timestep"] * episode["physics"]["substeps"])
    if (stage := _last_stage(run)) is not None:
        config = stage.config
        control_steps = config["episode_length"] / (config["physics"]["timestep"] * config["physics"]["substeps"])
    ended = balance[f"{TERMINATION}time_out"]["mean_last20"] + balance[f"{TERMINATION}illegal_contact"]["mean_last20"]
    found = [
        chart("feet on the deck, of 4", f"{REWARD}skate_feet_contact", 1 / paper["feet_weight"],
              "Success/feet_on_board", 1.0, limits=(0.0, 4.1)),
        chart("length of an episode, share of the limit", "Train/mean_episode_length", 1 / paper["episode_steps"],
              "Train/mean_episode_length", 1 / control_steps, limits=(0.0, 1.02), y_format=percent),
        chart("episodes that end early, share", f"{TERMINATION}illegal_contact", 1 / ended,
              f"{TERMINATION}tilt", 1.0, y_format=percent,
              note="Paper: the trunk touches something, of all episodes that end. Here: the robot falls."),
        chart("reward of an episode", "Train/mean_reward", 1.0, "Train/mean_reward", 1.0,
              note="The rewards are different; only the shapes can be compared."),
        chart("standard deviation of the actions", "Policy/mean_noise_std", 1.0, "Policy/mean_std", 1.0),
        chart("environment steps a second", "Perf/total_fps", 1.0, "Perf/total_fps", 1.0, limits=None,
              note="The paper's are of a GPU."),
    ]  # fmt: skip
    return [each for each in found if each is not None]


def _last_stage(run: Subject | None) -> Stage | None:
    stages = [stage for stage in run.stages if stage.table] if run is not None else []
    return stages[-1] if stages else None


def _terms(paper: Mapping[str, Any]) -> list[tuple[str, float, float, str, float | None]]:
    """Return each reward term of the paper's log with its last values, and the term in its place with its value."""
    first = _shipped("balance")
    rows = []
    for tag, values in paper["balance"].items():
        if not tag.startswith(REWARD):
            continue
        name = tag.removeprefix(REWARD)
        ours = REWARDS.get(name, "")
        rows.append((name, values["mean_last20"], values["max"], ours, first.final(REWARD + ours) if ours else None))
    return sorted(rows, key=lambda row: -abs(row[1]))


def _development(paper: Mapping[str, Any]) -> list[Chart]:
    found = []
    for title, tags in (
        ("length of an episode, control steps", ("Train/mean_episode_length",)),
        ("reward for feet on the deck", (f"{REWARD}skate_feet_contact", f"{REWARD}feet_skate_contact")),
    ):
        lines: list[Line | None] = []
        for i, (name, run) in enumerate(paper["development"].items()):
            for tag in tags:
                if tag in run:
                    curve = np.array(run[tag])
                    lines.append(Line(name, curve[:, 0], curve[:, 1], i))
        if (chart := line_chart(title, lines, x_label="iterations of 98,304 environment steps")) is not None:
            found.append(chart)
    return found


def _points(paper: Mapping[str, Any], usual: Mapping[str, Any], nested: Mapping[str, Any]) -> list[dict[str, str]]:
    """Return the points of comparison; our side is filled in from the defaults of this version."""
    rate = 1 / (nested["physics"]["timestep"] * nested["physics"]["substeps"])
    step = 1000 * nested["physics"]["timestep"]
    special = {
        "rate": f"{rate:g} Hz, physics steps of {step:g} ms",
        "observation": str(len(nested["observation"]["policy"])),
    }
    rows = []
    for point in paper["points"]:
        keys = [key for key in point["setting"].split(",") if key]
        values = [special[key] if key in special else shown(usual[key]) for key in keys]
        rows.append(
            {**{name: point[name] for name in ("point", "paper", "why")}, "ours": point["ours"].format(*values)}
        )
    return rows


def _reward_rows(theirs: Mapping[str, Any], ours: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Return name, weight with `reward=paper` and weight by default of each reward term."""

    def weight(config: Mapping[str, Any], name: str) -> str:
        row = config["reward"].get(name)
        return "–" if row is None or not row["weight"] else f"{row['weight']:g}"

    names = dict.fromkeys([*theirs["reward"], *ours["reward"]])
    rows = [(name, weight(theirs, name), weight(ours, name)) for name in names]
    return [row for row in rows if row[1:] != ("–", "–")]


def _by_group(rows: list[tuple[str, str, str]]) -> list[tuple[str, list[tuple[str, str, str]]]]:
    """Return differing settings by their group; rewards have a table of their own."""
    found: dict[str, list[tuple[str, str, str]]] = {}
    for key, theirs, ours in rows:
        group = key.partition(".")[0]
        if group != "reward":
            found.setdefault(group if "." in key else "other", []).append((key, theirs, ours))
    return list(found.items())
