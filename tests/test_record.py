"""`python -m skatemount.record`."""

from __future__ import annotations

import os
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
import torch
from PIL import Image

from skatemount.agent import MODULE, make_card
from skatemount.benchmark.evaluation import EVALUATION_SEED, Evaluator
from skatemount.benchmark.playback import play
from skatemount.checkpoint import save_checkpoint
from skatemount.config import Config, compose, to_dict
from skatemount.envs.task import MountTask
from skatemount.models import ActorCritic
from skatemount.record import default_folder, record
from skatemount.runs import RunFolder

needs_opengl = pytest.mark.skipif(
    os.environ.get("MUJOCO_GL") not in ("egl", "osmesa"), reason="needs OpenGL without a display"
)


def make_networks(config: Config) -> ActorCritic:
    mdp = MountTask(config=config).make_mdp(torch.Generator())
    return ActorCritic(config.network, mdp.observation.size, mdp.privileged.size)


@pytest.fixture
def checkpoint(runs_root: Path) -> Path:
    config = compose("balance", ["network.actor=[8]", "network.critic=[8]"])
    run = RunFolder.create(runs_root, "tests", "tiny", to_dict(config), [])
    folder = run.checkpoint(500)
    card = make_card(config, MountTask(config=config), 500)
    save_checkpoint(folder, {MODULE: make_networks(config)}, card, {})
    run.mark_checkpoint(folder, None)
    return folder


@needs_opengl
def test_makes_a_film_and_a_filmstrip(checkpoint: Path, capsys: pytest.CaptureFixture[str]) -> None:
    overrides = ["episode_length=0.12", "physics.threads=1"]
    record(compose(None, overrides), overrides)
    videos = checkpoint.parent.parent / "videos"
    film, strip = sorted(videos.iterdir())
    printed = capsys.readouterr().out
    assert film.name in printed and strip.name in printed
    assert "balance, seed 0, first episode: " in printed

    frames = imageio_ffmpeg.read_frames(str(film))
    about = next(frames)
    pictures = [np.frombuffer(f, np.uint8) for f in frames]
    assert (about["size"], about["fps"], len(pictures)) == ((960, 720), 25.0, 4)
    assert pictures[0].std() > 20  # something is to be seen
    assert (pictures[0] != pictures[-1]).mean() > 0.01  # and it moves
    with Image.open(strip) as picture:
        assert picture.size == (3 * 640 + 2 * 8, 2 * 480 + 8)  # of four moments


def test_films_go_to_their_run(checkpoint: Path, tmp_path: Path) -> None:
    videos = checkpoint.parent.parent / "videos"
    assert default_folder(checkpoint) == videos
    assert default_folder(checkpoint / "policy.safetensors") == videos
    assert default_folder(tmp_path / "alone.safetensors") == Path("videos")


@pytest.mark.parametrize("seed", [EVALUATION_SEED, EVALUATION_SEED + 1, EVALUATION_SEED + 2])
def test_what_is_filmed_is_the_first_episode_of_the_seed(seed: int) -> None:
    config = compose("balance", ["episode_length=1.2", "network.actor=[8]", "network.critic=[8]"])
    networks = make_networks(config)
    episode = play(networks, config, seed)
    evaluator = Evaluator(config, num_worlds=1, seed=seed)
    result = evaluator.run(networks, 1)
    evaluator.close()
    assert episode.succeeded == bool(result.successes)
    assert episode.verdict.startswith("succeeded" if episode.succeeded else "failed")
    assert [m.time for m in episode.moments] == pytest.approx([0.04 * i for i in range(len(episode.moments))])
    if result.ended["time_out"]:
        assert len(episode.moments) == 31
    else:
        assert "ended after" in episode.verdict
        assert len(episode.moments) < 31
