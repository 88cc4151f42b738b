"""Runs with a shipped policy as their checkpoints, for the tests of what follows a training."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

from skatemount.runs.checkpoint import POLICY_FILE
from skatemount.runs.folder import RunFolder
from skatemount.runs.shipped import POLICIES


def save(run: RunFolder, frames: int, policy: str = "balance") -> Path:
    """Save a shipped policy as a checkpoint."""
    folder = run.checkpoint(frames)
    folder.mkdir()
    for ending in (".safetensors", ".json"):
        shutil.copy(POLICIES / f"{policy}{ending}", (folder / POLICY_FILE).with_suffix(ending))
    run.mark_checkpoint(folder, None)
    return folder


def log(run: RunFolder, frames: int, **metrics: float | None) -> None:
    with (run.path / "metrics.jsonl").open("a") as file:
        named = {name.replace("_", "/", 1): value for name, value in metrics.items()}
        file.write(json.dumps({"frames": frames, **named}) + "\n")
