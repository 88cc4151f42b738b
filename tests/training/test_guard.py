"""Updates that are not finite are undone and counted, and several in a row end the training."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import torch
from tiny import BATCH, TINY

from skatemount.config import compose
from skatemount.runs.folder import RunFolder
from skatemount.training.callbacks import Callback
from skatemount.training.trainer import Trainer


class Broken(Callback):
    """Spoils a reward of some iterations."""

    def __init__(self, *iterations: int):
        self.iterations = iterations

    def on_batch_collected(self, trainer: Trainer, batch: Any) -> None:
        """Put nan into the reward of one step."""
        if trainer.iteration in self.iterations:
            batch["next", "reward"][2, 1] = torch.nan


def train(root: Path, callback: Callback, *settings: str) -> RunFolder:
    """Train `balance`, and return the run."""
    given = [*TINY, "logger.tensorboard=false", f"logger.root={root}", *settings]
    trainer = Trainer(compose("balance", given), given, callbacks=[callback])
    try:
        trainer.train()
    finally:
        trainer.close()
    return trainer.run


def test_an_update_that_is_not_finite_is_undone_and_counted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = train(tmp_path, Broken(1, 3), f"total_frames={5 * BATCH}")
    rows = [json.loads(line) for line in run.metrics_file.read_text().splitlines()]
    assert [row["Train/undone_updates"] for row in rows] == [0, 1, 1, 2, 2]
    assert ["Loss/kl" in row for row in rows] == [True, False, True, False, True]
    warning = capsys.readouterr().err
    assert "the update after 32 steps is undone: next.reward is not finite in 1 of 8 worlds" in warning
    assert "first in world 2 at step 1 of the batch" in warning


def test_several_in_a_row_end_the_run(tmp_path: Path) -> None:
    with pytest.raises(FloatingPointError, match="next.reward is not finite in 1 of 8 worlds") as error:
        train(tmp_path, Broken(2, 3, 4), "logger.checkpoint_every=2", f"total_frames={9 * BATCH}")
    (folder,) = (tmp_path / "skatemount").iterdir()
    latest = RunFolder.open(folder).latest
    assert latest is not None and latest.name == f"step_{4 * BATCH:012d}"
    text = str(error.value)
    assert f"3 updates in a row were undone for such a reason; the last good checkpoint is {latest}" in text
