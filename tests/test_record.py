"""`python -m skatemount.record`."""

from __future__ import annotations

import functools
import os
from pathlib import Path
from typing import Any

import exported
import imageio_ffmpeg
import numpy as np
import pytest
import torch
from PIL import Image

from skatemount.agents.trained_policy import MODULE, TrainedPolicy, make_policy_card
from skatemount.config import TrainConfig, compose, compose_program, to_dict
from skatemount.config.suite import SuiteConfig
from skatemount.envs.task import MountTask
from skatemount.evaluation.evaluator import Evaluator
from skatemount.evaluation.suite_task import EvaluationTask
from skatemount.models.actor_critic import ActorCritic
from skatemount.record import default_folder, record
from skatemount.rendering.film import HOLD
from skatemount.rendering.playback import replay_episodes
from skatemount.runs.checkpoint import save_checkpoint
from skatemount.runs.folder import RunFolder
from skatemount.utils.errors import ConfigError

needs_opengl = pytest.mark.skipif(
    os.environ.get("MUJOCO_GL") not in ("egl", "osmesa"), reason="needs OpenGL without a display"
)


def make_networks(config: TrainConfig) -> ActorCritic:
    mdp = MountTask(config=config).make_mdp(torch.Generator())
    return ActorCritic(config.network, mdp.observation.size, mdp.privileged.size, mdp.context.layout.num_joints)


@pytest.fixture
def checkpoint(runs_root: Path) -> Path:
    config = compose("balance", ["network.actor=[8]", "network.critic=[8]"])
    run = RunFolder.create(runs_root, "tests", "tiny", to_dict(config), [])
    folder = run.checkpoint(500)
    card = make_policy_card(config, MountTask(config=config), 500)
    save_checkpoint(folder, {MODULE: make_networks(config)}, card, {})
    run.mark_checkpoint(folder, None)
    return folder


SHORT = ["episode_length=0.12", "physics.threads=1", "physics.num_worlds=4"]
CHANGED = ", changed by episode_length=0.12, physics.num_worlds=4"
"""The part of a title that names the settings in `SHORT`."""


LATE = ["sensing=default", "sensing.target_delay=[0.04,0.04]"]


def film(checkpoint: Path, *overrides: str) -> list[Path]:
    record(compose_program("record", [*SHORT, *overrides]), [*SHORT, *overrides])
    return sorted((checkpoint.parent.parent / "videos").iterdir())


def read(path: Path) -> tuple[dict[str, Any], list[np.ndarray]]:
    frames = imageio_ffmpeg.read_frames(str(path))
    about = next(frames)
    width, height = about["size"]
    return about, [np.frombuffer(f, np.uint8).reshape(height, width, 3).astype(int) for f in frames]


@needs_opengl
def test_makes_a_film_and_a_picture_of_its_moments(checkpoint: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mp4, strip = film(checkpoint, "episode=2")
    printed = capsys.readouterr().out
    assert mp4.name in printed and strip.name in printed
    assert f"balance{CHANGED}, seed 0, episode 2\n" in printed and "episode2.mp4" in printed
    about, pictures = read(mp4)
    assert (about["size"], about["fps"]) == ((720, 540), 25.0)
    assert len(pictures) == 3 + round(HOLD * 25)  # the last one stays
    assert pictures[0].std() > 20  # not a blank picture
    assert (np.abs(pictures[0] - pictures[3]).max(-1) > 20).mean() > 0.005  # and it moves
    assert np.abs(pictures[4] - pictures[-1]).mean() < 1
    with Image.open(strip) as picture:
        assert picture.size == (3 * 640 + 2 * 8, 36 + 2 * 480 + 8)  # of four frames
    assert "played in 0:" in printed and "drawn in 0:" in printed


@needs_opengl
def test_without_a_success_it_says_so(checkpoint: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mp4, _ = film(checkpoint, "film.width=160", "film.height=120", "searched=4")
    printed = capsys.readouterr().out
    assert "episode 0, none of the first 4 episodes succeeded" in printed
    assert "episode 0: failed, not mounted at the time limit" in printed
    assert "episode0" in mp4.name


@needs_opengl
def test_size_speed_and_gif_are_settings(checkpoint: Path) -> None:
    settings = ["episode=1", "film.width=320", "film.height=180", "film.speed=0.5", "film.gif=true"]
    gif, mp4, _ = film(checkpoint, *settings)
    about, pictures = read(mp4)
    # Half as fast, so twice as many pictures of the three steps.
    assert (about["size"], about["fps"]) == ((320, 180), 25.0)
    assert len(pictures) == 6 + round(HOLD * 25)
    with Image.open(gif) as picture:
        assert (picture.format, picture.size) == ("GIF", (480, 270))
        durations = []
        for i in range(picture.n_frames):
            picture.seek(i)
            durations.append(picture.info["duration"])
        assert durations[:-1] == [80] * (len(durations) - 1)
        assert durations[-1] == HOLD * 1000
        assert picture.info["loop"] == 0


@needs_opengl
def test_several_episodes_share_a_film(checkpoint: Path, capsys: pytest.CaptureFixture[str]) -> None:
    small = ["film.width=320", "film.height=180", "film.caption=false"]
    mp4, sheet = film(checkpoint, "episodes=[3,0]", *small)
    assert mp4.name.endswith("_episodes3-0.mp4")
    printed = capsys.readouterr().out
    assert "seed 0, episodes 3 and 0\n" in printed and printed.index("episode 3: ") < printed.index("episode 0: ")
    _, pictures = read(mp4)
    assert pictures[0].shape == (180, 320, 3) and len(pictures) == 3 + round(HOLD * 25)
    with Image.open(sheet) as picture:
        assert picture.size == (6 * 288 + 5 * 8, 2 * 216)


@needs_opengl
def test_failures_are_shown_together(checkpoint: Path, capsys: pytest.CaptureFixture[str]) -> None:
    small = ["film.width=320", "film.height=180"]
    mp4, sheet = film(checkpoint, "episodes=failed", "failures=3", "searched=8", *small)
    assert mp4.name.endswith("_failed.mp4")
    printed = capsys.readouterr().out
    assert "seed 0, 8 of the first 8 episodes failed: not mounted at the time limit 8\n" in printed
    assert [f"episode {i}: failed" in printed for i in range(4)] == [True, True, True, False]
    with Image.open(sheet) as picture:
        assert picture.size == (6 * 288 + 5 * 8, 36 + 3 * (28 + 216))


def test_without_a_failure_there_is_no_film(tmp_path: Path) -> None:
    settings = ["checkpoint=pretrained:balance", "episodes=failed", "searched=3", f"output={tmp_path / 'films'}"]
    settings += ["start.ang_vel=[0,0]", "sensing=ideal", "episode_length=1.4", *SHORT[1:]]
    with pytest.raises(ConfigError, match="^episodes=failed: 0 of the first 3 episodes failed; searched=30 looks"):
        record(compose_program("record", settings), settings)
    assert list((tmp_path / "films").iterdir()) == []


def test_a_film_that_starts_too_late_leaves_nothing(checkpoint: Path) -> None:
    with pytest.raises(ConfigError, match=r"^film.start=1 must be below 0.12 s, the length of an episode$"):
        film(checkpoint, "episode=0", "film.start=1")
    assert not (checkpoint.parent.parent / "videos").exists()


@needs_opengl
def test_an_exported_policy_is_filmed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    settings = [f"checkpoint={exported.folder() / 'policy.onnx'}", "episode=1", f"output={tmp_path}"]
    settings += ["film.width=320", "film.height=240", *SHORT]
    record(compose_program("record", settings), settings)
    assert f"tiny on mount{CHANGED}, seed 0, episode 1\n" in capsys.readouterr().out
    assert len(read(tmp_path / "tiny_mount_seed0_episode1.mp4")[1]) == 3 + round(HOLD * 25)


@needs_opengl
@pytest.mark.slow
@pytest.mark.parametrize(
    ("suite", "settings", "told"),
    [
        ("drawn-boards", ["episodes=[3,1]", "film.background=plain"], "episodes 3 and 1"),
        ("delay", ["episodes=4", "film.speed=0.25", "film.start=0.1", "film.end=0.3"], "episodes 0, 1, 2 and 3"),
        ("pushed", ["episodes=failed", "failures=2", "searched=5", "film=1080p"], "5 of the first 5 episodes failed"),
    ],
)
def test_films_of_suites(
    suite: str, settings: list[str], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = [*settings, f"suite={suite}", "checkpoint=pretrained:anywhere", f"output={tmp_path}", "film.gif=true"]
    settings += ["episode_length=0.4", *SHORT[1:]]
    record(compose_program("record", settings), settings)
    assert f"anywhere on {suite}{CHANGED.replace('0.12', '0.4')}, seed 0, {told}" in capsys.readouterr().out
    gif, mp4, sheet = sorted(tmp_path.iterdir())
    size = (1920, 1080) if "film=1080p" in settings else (720, 540)
    about, pictures = read(mp4)
    assert (about["size"], about["fps"]) == (size, 25.0)
    # The slow motion shows 0.2 s in 0.8 s.
    assert len(pictures) == (20 if suite == "delay" else 10) + round(HOLD * 25)
    rows = 4 if suite == "delay" else 2
    with Image.open(sheet) as picture:
        assert picture.size == (6 * 288 + 5 * 8, 36 + rows * (28 + 216))
    with Image.open(gif) as picture:
        assert picture.n_frames == (11 if suite == "delay" else 6)


@needs_opengl
def test_films_with_late_targets_and_noisy_sensors(checkpoint: Path) -> None:
    usual, _ = film(checkpoint, "episode=1")
    _, still = read(usual)
    late, _ = film(checkpoint, "episode=1", *LATE)
    _, pictures = read(late)
    assert len(pictures) == len(still) and any((a != b).any() for a, b in zip(pictures, still, strict=True))


@needs_opengl
def test_a_fast_film_skips_steps(checkpoint: Path) -> None:
    small = ["episode=1", "film.width=160", "film.height=120"]
    mp4, _ = film(checkpoint, *small, "film.speed=5")
    about, pictures = read(mp4)
    assert about["fps"] == pytest.approx(125 / 3, abs=0.1)
    assert len(pictures) == 1 + round(HOLD * 125 / 3)


@needs_opengl
def test_cameras_differ(checkpoint: Path) -> None:
    seen = []
    for camera in ("follow", "top"):
        mp4, _ = film(checkpoint, "episode=1", "film.width=160", "film.height=120", f"film.camera={camera}")
        seen.append(read(mp4)[1][0])
    assert np.abs(seen[0] - seen[1]).mean() > 10


def test_films_go_to_their_run(checkpoint: Path, tmp_path: Path) -> None:
    videos = checkpoint.parent.parent / "videos"
    assert default_folder(checkpoint) == videos
    assert default_folder(checkpoint / "policy.safetensors") == videos
    assert default_folder(tmp_path / "alone.safetensors") == Path("videos")


def test_a_film_is_the_evaluated_episode_exactly(checkpoint: Path) -> None:
    # Some of these stand to the end, some are thrown over; a fixed and a free board, late targets and noisy sensors,
    # several rounds of three worlds.
    changes = ["start.x=[-0.1,0.1]", "start.ang_vel=[-1.2,1.2]", "episode_length=1.2"]
    suite = SuiteConfig(
        name="test",
        stage="balance",
        overrides=changes,
        variants={"usual": [], "free": ["start.board_fixed=0"], "late": LATE},
    )
    trial = EvaluationTask.of(TrainedPolicy.load(str(checkpoint)), suite, ["physics.num_worlds=3", "physics.threads=1"])
    evaluated, final = trial.evaluate(21), final_positions(trial, rounds=3)
    ends = evaluated.records.end
    assert (ends == 0).any() and (ends > 0).any()
    early, late = (int(mask.nonzero()[-1]) for mask in (ends > 0, ends == 0))
    for number in (early, late, 1, 5):
        assert (number == 5) == (trial.variant_of(number)[0] == "late") or number in (early, late)
        (episode,) = replay_episodes(trial, [number], parts=2 if number == late else 1)
        columns, played_columns = (
            {**vars(record), **record.metrics} for record in (evaluated.records[number : number + 1], episode.record)
        )
        for name in columns.keys() - {"metrics"}:
            value, played = columns[name], played_columns[name]
            assert torch.equal(played, value) or (played != played).all() and (value != value).all(), name
        last = episode.frames[-1]
        assert last.time == pytest.approx(float(evaluated.records.duration[number]))
        np.testing.assert_array_equal(last.qpos, final[number])
        assert episode.summary.startswith("succeeded" if episode.record.success else "failed")
        assert ("ended after" in episode.summary) == bool(ends[number])
    assert len(episode.frames) == round(float(evaluated.records.duration[number]) / 0.04) + 1


def final_positions(trial: EvaluationTask, rounds: int) -> dict[int, np.ndarray]:
    """Every episode's last position, as the engine has it when a batch of them is evaluated."""
    final: dict[int, np.ndarray] = {}

    def note(step: int, evaluator: Evaluator, turn: int, variant: int) -> None:
        for world in range(evaluator.env.num_worlds):
            number = (turn * evaluator.env.num_worlds + world) * len(trial.configs) + variant
            if step and number not in final and evaluator.has_ended(world):
                final[number] = evaluator.env.physics.render_data(world)[1].qpos.copy()

    for i, variant in enumerate(trial.configs):
        evaluator = trial.evaluator(variant)
        for turn in range(rounds):
            watch = functools.partial(note, evaluator=evaluator, turn=turn, variant=i)
            evaluator.round(trial.agent.networks, turn, watch)
        evaluator.close()
    return final


def test_a_suite_of_suites_cannot_be_filmed(checkpoint: Path) -> None:
    with pytest.raises(ConfigError, match="suite=all: name one to film, of gait, balance-fixed"):
        record(compose_program("record", ["suite=all"]), ["suite=all"])


def test_the_gif_of_the_readme_is_small(repo_root: Path) -> None:
    gif = repo_root / "docs" / "_static" / "best.gif"
    assert gif.stat().st_size < 3e6
    with Image.open(gif) as picture:
        assert picture.size == (480, 360)
        assert picture.n_frames > 60
