"""A user's own curriculum is one class, named by the settings."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import defaults
import pytest

from skatemount.config import compose
from skatemount.curriculum.auto import AutoCurriculum
from skatemount.curriculum.base import make_curriculum
from skatemount.training.trainer import Trainer
from skatemount.utils.errors import ConfigError

OWN = '''
import torch
from skatemount.envs.starts import StartPoses


class OneSpot:
    """Always the same place; counts the episodes that ended there."""

    def __init__(self, config, deck_height):
        self.x = config.params["x"]
        self.height = deck_height
        self.ended = 0

    def sample_poses(self, n, generator):
        xy = torch.tensor([[self.x, 0.0]]).repeat(n, 1)
        full = torch.full((n,), self.height)
        return StartPoses(xy, torch.zeros(n), full, torch.ones(n, dtype=torch.bool), torch.zeros(n, dtype=torch.long))

    def observe_step(self, episode, outcome, done):
        self.ended += int(done.sum())

    def update(self):
        pass

    def metrics(self):
        return {"Curriculum/ended": float(self.ended)}

    def draw(self, path, title):
        path.write_text(title)

    def state_dict(self):
        return {"ended": self.ended}

    def load_state_dict(self, state):
        self.ended = state["ended"]
'''


def test_kinds_have_their_classes() -> None:
    assert make_curriculum(defaults.curriculum(), 0.1) is None
    assert isinstance(make_curriculum(defaults.curriculum(kind="auto"), 0.1), AutoCurriculum)


def test_a_curriculum_of_ones_own_is_trained_with(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "one_spot.py").write_text(OWN)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "one_spot", raising=False)
    tiny = [
        "physics.num_worlds=4",
        "physics.threads=1",
        "torch_threads=1",
        "collector.steps_per_env=4",
        "episode_length=0.2",
    ]
    quiet = [
        "logger.evaluate_every=0",
        "logger.final_episodes=0",
        "logger.tensorboard=false",
        "algorithm.minibatches=1",
    ]
    own = ["+curriculum=none", "curriculum.kind=one_spot:OneSpot", "+curriculum.params.x=0.8", "total_frames=64"]
    trainer = Trainer(compose("forward", [*tiny, *quiet, *own, f"logger.root={tmp_path}"]))
    trainer.env.reset()
    assert math.isclose(float(trainer.env.sim.board_pos_base[:, :2].norm(dim=1).mean()), 0.8, abs_tol=0.1)
    trainer.train()
    trainer.close()
    assert "Curriculum/ended" in trainer.run.metrics_file.read_text()
    assert "64 steps" in trainer.run.curriculum_png.read_text()


@pytest.mark.parametrize("kind", ["no_such_module:Thing", "math:Thing", "math:pi"])
def test_what_cannot_be_made_is_one_line(kind: str) -> None:
    config = defaults.curriculum(kind=kind)
    config.validate()
    with pytest.raises(ConfigError) as error:
        make_curriculum(config, 0.1)
    assert f"curriculum.kind={kind}" in str(error.value) and "\n" not in str(error.value)


def test_unknown_kinds_are_listed() -> None:
    with pytest.raises(ConfigError, match="none, stages, auto, mixture, or module:Class"):
        defaults.curriculum(kind="automatic").validate()
