"""Two tiny runs that all tests of reports read."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from tiny import BATCH, TINY

from skatemount.config import compose
from skatemount.runs.folder import RunFolder
from skatemount.train import train

SETTINGS = [each for each in TINY if not each.startswith(("logger.final", "episode_length"))]
SECOND = "second <img src=x>"
"""A name that a page must not take for HTML."""

ITERATIONS = 8
"""Enough that the first episodes end."""


@pytest.fixture(scope="session")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of runs: `first`, and `SECOND` with another seed and learning rate; the first was evaluated."""
    root = tmp_path_factory.mktemp("reports") / "runs"
    for name, more in (
        ("first", ["logger.final_episodes=4"]),
        (SECOND, ["logger.final_episodes=0", "seed=1", "algorithm.learning_rate=3e-4"]),
    ):
        given = [
            "stage=balance", *SETTINGS, f"total_frames={ITERATIONS * BATCH}", f"logger.root={root}",
            f"logger.name={name}", "episode_length=1.0", "logger.tensorboard=false", *more,
        ]  # fmt: skip
        train(compose(None, given), given)
    return root


def _run(root: Path, name: str) -> Path:
    (found,) = (path for path in (root / "skatemount").iterdir() if path.name.endswith(f"_{name}"))
    return found


@pytest.fixture(scope="session")
def first(root: Path) -> Path:
    """The first run."""
    return _run(root, "first")


@pytest.fixture(scope="session")
def second(root: Path) -> Path:
    """The second run."""
    return _run(root, SECOND)


@pytest.fixture(scope="session")
def sweep(root: Path, first: Path, second: Path) -> Path:
    """A sweep of two seeds at two learning rates: the two runs, each twice, and a job that failed."""
    folder = root / "skatemount" / "2026-01-02_03-04-05_sweep"
    (folder / "jobs").mkdir(parents=True)
    command = ["stage=balance", "algorithm.learning_rate=1e-3,3e-4,9", "seed=0,1"]
    (folder / "sweep.json").write_text(json.dumps({"format": 1, "program": "train", "command": command}))
    jobs = [("1e-3", "0", first, 3), ("1e-3", "1", first, 4), ("3e-4", "0", second, 1), ("9", "0", None, 0)]
    for number, (rate, seed, run, successes) in enumerate(jobs, 1):
        name = f"learning_rate={rate},seed={seed}"
        if run is not None:
            shutil.copytree(run, folder / name)
        record = {
            "format": 1,
            "number": number,
            "status": "failed" if run is None else "finished",
            "settings": {"algorithm.learning_rate": rate, "seed": seed},
            "success": None if run is None else successes / 4,
            "successes": None if run is None else successes,
            "episodes": None if run is None else 4,
            "steps": ITERATIONS * BATCH,
            "run": None if run is None else name,
            "error": "algorithm.learning_rate=9 must be smaller" if run is None else None,
            "overrides": [],
        }
        (folder / "jobs" / f"{name}.json").write_text(json.dumps(record))
    return folder


@pytest.fixture(scope="session")
def begun(root: Path) -> Path:
    """A run that was stopped before its first checkpoint, without metrics."""
    from skatemount.config import to_dict

    return RunFolder.create(root, "begun", "run", to_dict(compose("balance")), ["stage=balance"]).path
