"""Updates that are not finite are undone and counted, and several in a row end the training."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from tiny import BATCH, TINY
from torch import Tensor

from skatemount.config import compose
from skatemount.envs.observations import OBSERVATIONS, observation
from skatemount.envs.rewards import REWARDS, reward
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.terms import TaskContext
from skatemount.runs.folder import RunFolder
from skatemount.training.callbacks import Callback
from skatemount.training.trainer import Trainer

pytestmark = pytest.mark.usefixtures("no_pictures")


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


@pytest.fixture
def spoiled() -> Iterator[None]:
    """A reward and an observation that are not finite in the third step of an episode."""
    before = REWARDS.snapshot(), OBSERVATIONS.snapshot()

    @reward
    def unsteady(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
        return torch.where(episode.step == 3, torch.nan, 0.0)

    @observation(2, "scalars")
    def unseen(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
        return torch.where(episode.step == 3, torch.inf, 0.0).unsqueeze(1).repeat(1, 2)

    yield
    REWARDS.restore(before[0])
    OBSERVATIONS.restore(before[1])


@pytest.mark.usefixtures("spoiled")
@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("reward.unsteady.weight=1", "next.reward is not finite in 8 of 8 worlds, .*, from the term reward.unsteady"),
        ("observation.policy.unseen={}", "observation is not finite .*, from the term observation.policy.unseen"),
        (
            "observation.privileged.unseen={}",
            "privileged is not finite .*, from the term observation.privileged.unseen",
        ),
    ],
)
def test_the_term_that_is_not_finite_is_named(
    setting: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    phase = "collector.random_phase=false"
    train(tmp_path, Broken(), setting, phase, "logger.jsonl=false", f"total_frames={2 * BATCH}")
    assert re.search(rf"the update after 0 steps is undone: (next\.)?{said}$", capsys.readouterr().err, re.MULTILINE)


def test_several_in_a_row_end_the_run(tmp_path: Path) -> None:
    with pytest.raises(FloatingPointError, match="next.reward is not finite in 1 of 8 worlds") as error:
        train(tmp_path, Broken(2, 3, 4), "logger.checkpoint_every=2", f"total_frames={9 * BATCH}")
    (folder,) = (tmp_path / "skatemount").iterdir()
    latest = RunFolder.open(folder).latest
    assert latest is not None and latest.name == f"step_{4 * BATCH:012d}"
    text = str(error.value)
    assert f"3 updates in a row were undone for such a reason; the last good checkpoint is {latest}" in text
