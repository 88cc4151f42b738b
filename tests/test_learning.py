"""Training learns: the one test that would notice if the whole stopped working while every part still passes."""

from __future__ import annotations

from pathlib import Path

import pytest

from skatemount.config import compose
from skatemount.training.trainer import Trainer

FRAMES = 900_000
ENOUGH = 0.6
"""Success that the stage reaches with a wide margin after `FRAMES` steps: 0.83 with seed 0 (docs/decisions/0005)."""


@pytest.mark.slow
def test_balance_is_learned_from_scratch(runs_root: Path) -> None:
    overrides = [f"total_frames={FRAMES}", "logger.evaluate_every=0", "logger.final_episodes=512"]
    trainer = Trainer(compose("balance", overrides))
    try:
        result = trainer.train()
    finally:
        trainer.close()
    assert result is not None and result.success_rate >= ENOUGH
