"""Score of a run: the success of its final policy, kept in the run's folder."""

from __future__ import annotations

import json
from pathlib import Path

from skatemount.evaluation.results import Evaluation
from skatemount.runs import atomic
from skatemount.runs.checkpoint import read_card
from skatemount.runs.folder import RunFolder
from skatemount.runs.serialization import parse_json
from skatemount.runs.sweep import Score

EVALUATION_FILE = "evaluation.json"


def save_evaluation(run: RunFolder, evaluation: Evaluation, frames: int) -> Path:
    """Write the evaluation of a run's final policy, ``evaluation.json``, and return the file.

    Args:
        run: The run.
        evaluation: The evaluation.
        frames: Environment steps that the policy was trained for.
    """
    path = run.path / EVALUATION_FILE
    counts = {"frames": frames, "successes": int(evaluation.records.success.sum())}
    document = counts | evaluation.to_dict(failed_episodes=False)
    atomic.write_text(path, json.dumps(document, indent=2, allow_nan=False) + "\n")
    return path


def score_of(run: RunFolder) -> Score:
    """Return the success of a run's latest policy.

    It is that of the final evaluation; without one that of the last evaluation during the training, if the latest
    checkpoint is of that moment; else it is not a number.

    Args:
        run: A run, or a chain of stages, of which the last stage counts.
    """
    latest = run.latest
    if latest is None:
        return Score.of(0, 0, 0, run.path)
    card = read_card(latest)
    trained = sum(read_card(part.latest).frames for part in run.parts if part.latest is not None) or card.frames
    folder = RunFolder.open(latest).path
    path = folder / EVALUATION_FILE
    if path.is_file():
        document = parse_json(path.read_bytes(), path)
        if document.get("frames") == card.frames:
            return Score.of(int(document["successes"]), int(document["episodes"]), trained, run.path)
    rate = card.metrics.get("Evaluation/success")
    if rate is None:
        return Score.of(0, 0, trained, run.path)
    episodes = int(RunFolder(folder).config["logger"]["evaluate_episodes"])
    return Score.of(round(rate * episodes), episodes, trained, run.path)
