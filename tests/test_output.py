"""Results reach their files, whatever becomes of the standard output."""

from __future__ import annotations

import io
import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tiny import BATCH, TINY

from skatemount import cli
from skatemount.evaluate import evaluate
from skatemount.runs.find import find_checkpoint
from skatemount.runs.folder import RunFolder
from skatemount.train import train
from skatemount.training.score import score_of

pytestmark = pytest.mark.usefixtures("no_pictures")


@pytest.fixture(params=["closed pipe", "full disk", "ascii", "closed"])
def output(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """A standard output; `run` sets it, because pytest sets its own between fixtures and test."""
    file: Any
    if request.param == "closed pipe":
        reading, writing = os.pipe()
        os.close(reading)
        file = os.fdopen(writing, "w")
    elif request.param == "full disk":
        file = open("/dev/full", "w")
    elif request.param == "ascii":
        file = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    else:
        file = None
    monkeypatch.setenv("FORCE_COLOR", "1")
    yield file
    if isinstance(file, io.TextIOWrapper) and isinstance(file.buffer, io.BytesIO):
        file.flush()
        assert b"\x1b" not in file.buffer.getvalue() and b"episodes" in file.buffer.getvalue()


def run(verb: Any, program: str, output: Any, monkeypatch: pytest.MonkeyPatch, *arguments: str) -> None:
    monkeypatch.setattr(sys, "stdout", output)
    monkeypatch.setenv("HYDRA_FULL_ERROR", "0")
    monkeypatch.setattr(sys, "argv", [program, *arguments])
    cli.run(verb, program)


def test_an_evaluation_reaches_its_file(output: Any, runs_root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run(
        evaluate, "evaluate", output, monkeypatch, "checkpoint=pretrained:balance", "json=r.json", "output=results",
        "episodes=3", "physics.num_worlds=4", "physics.threads=1", "episode_length=0.5",
    )  # fmt: skip
    assert json.loads(Path("r.json").read_text())["episodes"] == 3
    assert len(list(Path("results").iterdir())) == 2


def test_a_training_goes_on_to_its_end(output: Any, runs_root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tiny = [each for each in TINY if not each.startswith("logger.final")]
    run(
        train,
        "train",
        output,
        monkeypatch,
        "stage=balance",
        *tiny,
        "logger.final_episodes=2",
        f"total_frames={2 * BATCH}",
    )
    run_folder = RunFolder.open(find_checkpoint("latest"))
    score = score_of(run_folder)
    assert (score.frames, score.episodes) == (2 * BATCH, 2)
    assert json.loads((run_folder.path / "evaluation.json").read_text())["successes"] == score.successes
