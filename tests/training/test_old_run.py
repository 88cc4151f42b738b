"""A run that an older version saved: it resumes with the same state, and its policy is the same."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
import safetensors.torch
import torch
from tiny import BATCH

from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.config import TrainConfig, compose
from skatemount.runs.checkpoint import TRAINING_FOLDER, load_training_state
from skatemount.runs.folder import RunFolder
from skatemount.runs.metrics import read_metrics
from skatemount.runs.serialization import write_tensors
from skatemount.training.resume import resume_config
from skatemount.training.trainer import Trainer
from skatemount.utils.errors import ConfigError


def go_on(run: RunFolder) -> TrainConfig:
    given = [f"resume={run.path}", f"total_frames={6 * BATCH}"]
    return resume_config(compose(None, given), given)


def weights(run: RunFolder) -> dict[str, torch.Tensor]:
    return TrainedPolicy.load(str(run.path)).networks.state_dict()


OLD_RUN = Path(__file__).parents[1] / "golden" / "data" / "old_run"


@pytest.fixture
def old_run(tmp_path: Path) -> RunFolder:
    """A run of commit 5ce7322, five iterations with the automatic curriculum."""
    return RunFolder.open(shutil.copytree(OLD_RUN, tmp_path / "runs" / "exp" / "old"))


def test_a_run_of_an_older_version_resumes(old_run: RunFolder) -> None:
    assert old_run.latest is not None
    saved, policy = load_training_state(old_run.latest), weights(old_run)
    config = go_on(old_run)
    trainer = Trainer(config)
    for key, value in trainer.networks.state_dict().items():
        assert torch.equal(value, policy[key]), key
    assert (trainer.frames, trainer.iteration) == (5 * BATCH, 5)
    moments = trainer.algorithm.state_dict()["optimizer"]
    assert len(moments) == len(saved["ppo"]["optimizer"]) == len(list(trainer.networks.parameters()))
    for i, values in enumerate(moments.values()):
        assert all(torch.equal(value, saved["ppo"]["optimizer"][str(i)][name]) for name, value in values.items())
    assert trainer.curriculum is not None
    assert torch.equal(trainer.curriculum.state_dict()["opened"], saved["curriculum"]["opened"])
    assert torch.equal(trainer.env.generator.get_state(), saved["env"]["generator"])
    trainer.train()
    trainer.close()
    assert old_run.latest.name == f"step_{6 * BATCH:012d}"
    assert load_training_state(old_run.latest)["progress"]["iteration"] == 6
    assert read_metrics(old_run.metrics_file)["frames"].tolist() == [i * BATCH for i in range(1, 7)]
    assert old_run.metrics_file.name == "metrics.jsonl" and not (old_run.path / "metrics.csv").exists()


def test_samples_that_features_of_an_older_run_have_missed_are_read(old_run: RunFolder) -> None:
    assert old_run.latest is not None
    path = old_run.latest / TRAINING_FOLDER
    document = json.loads((path / "state.json").read_text())
    tensors = safetensors.torch.load_file(path / "tensors.safetensors")
    missed = tensors["state.behind.0"]
    missed[3] = 10
    document["tensors_sha256"] = write_tensors(path / "tensors.safetensors", tensors)
    (path / "state.json").write_text(json.dumps(document))
    trainer = Trainer(go_on(old_run))
    trainer.close()
    count = trainer.networks.normalizers[0].count
    assert torch.equal(count, weights(old_run)["normalizers.0.count"] - missed)
    assert count[3] == count[0] - 10


def test_a_damaged_state_of_an_older_version_is_named(old_run: RunFolder) -> None:
    assert old_run.latest is not None
    path = old_run.latest / TRAINING_FOLDER / "state.json"
    path.write_text(path.read_text().replace('"frames": 160', '"frames": 320'))
    with pytest.raises(ConfigError) as error:
        Trainer(go_on(old_run))
    assert str(error.value).startswith(f"{path}: damaged") and "\n" not in str(error.value)
