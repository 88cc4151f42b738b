"""Scouts take the mean action, and nothing is learnt from them."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from tensordict import TensorDictBase
from tiny import SILENT, TINY

from skatemount.config import compose
from skatemount.curriculum.scouts import ScoutingActor
from skatemount.training import Trainer


@pytest.fixture
def trainer(tmp_path: Path) -> Trainer:
    scouting = ["curriculum.harvest=0.2", "curriculum.scouts=0.25", "init_from=null"]
    trainer = Trainer(compose("mount", [*TINY, *SILENT, f"logger.root={tmp_path}", *scouting]), [])
    yield trainer
    trainer.close()


def test_the_first_worlds_do_not_explore(trainer: Trainer) -> None:
    seen = trainer.env.reset()
    with torch.no_grad():
        acted = ScoutingActor(trainer.networks.actor, 3)(seen.clone())
        alone = trainer.networks.actor(seen.clone())
    assert torch.equal(acted["action"][:3], alone["loc"][:3])
    assert bool((acted["action"][3:] != alone["loc"][3:]).any(1).all())


def test_a_training_has_scouts_and_learns_from_the_others(trainer: Trainer, monkeypatch: pytest.MonkeyPatch) -> None:
    batches: list[TensorDictBase] = []
    update = trainer.ppo.update
    monkeypatch.setattr(trainer.ppo, "update", lambda batch: batches.append(batch.clone()) or update(batch))
    collected: list[torch.Tensor] = []
    trainer.env.listeners.append(lambda episode, outcome, done: collected.append(episode.action.clone()))
    next(trainer.iterations())
    (batch,) = batches
    actions = torch.stack(collected, 1)
    assert actions.shape[:2] == (8, 4) and batch.shape == (6, 4)
    limit = trainer.task.scene.robot.config.action_clip
    torch.testing.assert_close(batch["action"].clamp(-limit, limit), actions[2:])
    assert trainer.frames == 32  # they are simulated like the others
