"""Results of a search: its table, files of it, and the best settings as a YAML file."""

from __future__ import annotations

import csv
import io
import json
import shlex
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from skatemount.evaluation.intervals import wilson_interval
from skatemount.runs import atomic
from skatemount.runs.sweep import RESULTS_FILE, SEARCH
from skatemount.searching.best import best_command, write_best
from skatemount.searching.folder import SearchFolder
from skatemount.searching.picture import draw
from skatemount.searching.study import SharedStudy, shown
from skatemount.utils.decoration import Decoration
from skatemount.utils.formatting import format_count
from skatemount.utils.tables import new_table, rendered

if TYPE_CHECKING:
    import optuna

CSV_FILE = "results.csv"
PICTURE_FILE = "search.png"
FORMAT = 1

Record = dict[str, Any]


def records_of(study: SharedStudy) -> list[Record]:
    """Return a record of each trial, in the order of their numbers.

    The ``status`` is ``finished``, ``pruned``, ``failed``, ``running`` or ``stopped``; a trial that was stopped goes on
    with the next start. The success of a pruned trial is that at the last point that was compared.
    """
    found = []
    for trial in study.trials():
        notes = trial.user_attrs
        status = _status(study, trial)
        success = trial.value if status == "finished" else None
        if trial.intermediate_values and status != "finished":
            success = trial.intermediate_values[max(trial.intermediate_values)]
        successes, episodes = notes.get("successes"), notes.get("episodes")
        low, high = (
            wilson_interval(int(successes or 0), int(episodes)) if status == "finished" and episodes else (None, None)
        )
        found.append(
            {
                "number": trial.number + 1,
                "status": status,
                "settings": {each.key: trial.params.get(each.key) for each in study.dimensions},
                "success": success,
                "successes": successes if status == "finished" else None,
                "episodes": episodes if status == "finished" else None,
                "low": low,
                "high": high,
                "steps": notes.get("steps"),
                "run": notes.get("run"),
                "error": notes.get("error"),
            }
        )
    return found


def write(folder: SearchFolder, study: SharedStudy) -> list[Record]:
    """Write the table as JSON and CSV, the picture, and the best settings; return the records of the trials.

    Args:
        folder: Folder of the search.
        study: Its study.
    """
    with folder.alone():
        records = records_of(study)
        top = best(records)
        document = {
            "format": FORMAT,
            "program": SEARCH,
            "space": {each.key: each.written for each in study.dimensions},
            "trials": records,
            "best": top,
        }
        atomic.write_text(folder.path / RESULTS_FILE, json.dumps(document, indent=2, allow_nan=False) + "\n")
        atomic.write_text(folder.path / CSV_FILE, _csv(records, [each.key for each in study.dimensions]))
        if top is not None:
            write_best(folder, study, top)
    if top is not None:
        # The others need not wait for the picture.
        with Decoration("the picture of the search"):
            draw(records, study.dimensions, folder.path / PICTURE_FILE, folder.path.name)
    return records


def best(records: Sequence[Mapping[str, Any]]) -> Mapping[str, Any] | None:
    """Return the record of the finished trial with the highest success, the first of equals; None if there is none."""
    rated = [each for each in records if each["status"] == "finished"]
    return max(rated, key=lambda each: each["success"], default=None)


def table(records: Sequence[Mapping[str, Any]]) -> str:
    """Return the table of the trials as text.

    Args:
        records: Result of `records_of`.
    """
    keys = list(dict.fromkeys(key for record in records for key in record["settings"]))
    last = [key.rpartition(".")[2] for key in keys]
    headings = [short if last.count(short) == 1 else key for key, short in zip(keys, last)]
    made = new_table("trial", *headings, "success", "95 % interval", "steps", "status")
    for record in records:
        values = (record["settings"][key] for key in keys)
        made.add_row(
            str(record["number"]),
            *("-" if value is None else shown(value) for value in values),
            "-" if record["success"] is None else f"{record['success']:.1%}",
            "-" if record["low"] is None else f"{record['low']:.1%} to {record['high']:.1%}",
            "-" if record["steps"] is None else format_count(record["steps"]),
            record["status"],
        )
    return rendered(made)


def report(folder: SearchFolder, records: Sequence[Mapping[str, Any]], overrides: Sequence[str] = ()) -> str:
    """Return what a search prints at its end: the table, why trials failed, the files, and the way on.

    Args:
        folder: Folder of the search.
        records: Result of `records_of`.
        overrides: Overrides of every training.
    """
    lines = [table(records), ""]
    lines += [f"trial {each['number']} failed: {each['error']}" for each in records if each["status"] == "failed"]
    running = sum(each["status"] == "running" for each in records)
    if running:
        lines.append(f"trials that other processes still train: {running}; they write the results when they end")
    top = best(records)
    lines.append(f"written to {folder.path / RESULTS_FILE}, {CSV_FILE}{f', {PICTURE_FILE}' if top else ''}")
    if top is None:
        return "\n".join([*lines, "no trial has succeeded"])
    if not top["success"]:
        # The first of equals is no better than the others.
        return "\n".join([*lines, "no trial had a success"])
    evaluate = ["python", "-m", "skatemount.evaluate", f"checkpoint={folder.path / top['run']}"]
    lines += [
        f"best: trial {top['number']}, {shlex.join(evaluate)}",
        f"train it again: {best_command(folder, overrides)}",
    ]
    return "\n".join(lines)


def _status(study: SharedStudy, trial: optuna.trial.FrozenTrial) -> str:
    state = trial.state.name
    if state in ("RUNNING", "WAITING"):
        fresh = study.folder.sign(trial.number + 1).is_fresh(study.settings.stale_after)
        return "running" if fresh else "stopped"
    return {"COMPLETE": "finished", "PRUNED": "pruned", "FAIL": "failed"}[state]


def _csv(records: Sequence[Mapping[str, Any]], keys: Sequence[str]) -> str:
    text = io.StringIO()
    names = ("number", "status", "success", "low", "high", "episodes", "steps", "run", "error")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([names[0], *keys, *names[1:]])
    for record in records:
        writer.writerow([record["number"], *(record["settings"][key] for key in keys), *(record[n] for n in names[1:])])
    return text.getvalue()
