"""Settings of films."""

from __future__ import annotations

import dataclasses

import pytest

from skatemount.config import RecordConfig, compose_program
from skatemount.config.film import numbers_of
from skatemount.utils.errors import ConfigError


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("film.width=641", "film.width=641 must be an even number of pixels"),
        ("film.height=100", "film.height=100 must be from 120 to 2160 pixels, an even number"),
        ("film.camera=left", "film.camera=left must be one of follow, side, top, fixed"),
        ("film.speed=0", "film.speed=0.0 must be from 0.05 to 20; 0.5 plays at half speed"),
        ("film.speed=nan", "film.speed=nan must be from 0.05 to 20"),
        ("film.background=white", "film.background=white must be one of floor, plain"),
        ("film.gif_width=10", "film.gif_width=10 must be from 80 to 1920 pixels"),
        ("film.start=-1", "film.start=-1.0 must be from 0 to 3600 s"),
        ("film.end=0", "film.end=0.0 must be above 0 and at most 3600 s"),
        ("film.start=2 film.end=1.5", "film.end=1.5 must be above film.start=2.0"),
        ("film=4k", "film=4k: there is no film 4k; there are: 1080p, default"),
        ("episode=-1", "episode=-1 must be 0 or more"),
        ("episodes=some", "episodes=some must be a number such as 4, a list of numbers such as [0,3,7], or failed"),
        ("episodes=[0,x]", "episodes=[0, 'x'] must be a number such as 4, a list of numbers"),
        ("episodes=true", "episodes=True must be a number such as 4"),
        ("episodes=1.5", "episodes=1.5 must be a number such as 4"),
        ("episodes=0", "episodes=0 must be from 1 to 16: so many episodes share a film"),
        ("episodes=17", "episodes=17 must be from 1 to 16"),
        ("episodes=[]", "episodes=[] has 0 episodes; a film shows 1 to 16"),
        ("episodes=[-1,2]", "episodes=[-1, 2] must be numbers of episodes, each from 0"),
        ("episodes=[2,3,2]", "episodes=[2, 3, 2] names an episode twice"),
        ("episodes=failed episode=3", "episodes=failed with episode=3: leave out one of the two"),
        ("failures=17", "failures=17 must be from 1 to 16"),
        ("searched=0", "searched=0 must be from 1 to"),
        ("searched=1000000 episode_length=3600", "searched=1000000: episodes of episode_length=3600.0 s"),
        ("film.speed=0.05 episode_length=3600 film=1080p", "film.width=1920 and film.height=1080 has"),
    ],
)
def test_refused_values_are_named(setting: str, message: str) -> None:
    with pytest.raises(ConfigError) as error:
        compose_program("record", setting.split())
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("setting", "numbers"), [("4", [0, 1, 2, 3]), ("[0,3,12]", [0, 3, 12]), ("[7]", [7]), ("failed", None)]
)
def test_several_episodes_are_named_or_counted(setting: str, numbers: list[int] | None) -> None:
    assert numbers_of(record_settings(f"episodes={setting}").episodes) == numbers
    assert numbers_of(record_settings().episodes) is None


def test_full_hd_changes_the_size_alone() -> None:
    usual, large = record_settings().film, record_settings("film=1080p", "film.gif=true").film
    assert (large.width, large.height, large.gif) == (1920, 1080, True)
    assert dataclasses.replace(large, width=usual.width, height=usual.height, gif=False) == usual


def test_cameras_are_those_that_can_be_drawn() -> None:
    from skatemount.config.film import CAMERAS
    from skatemount.rendering.camera import VIEWS

    assert tuple(VIEWS) == CAMERAS


def record_settings(*overrides: str) -> RecordConfig:
    config = compose_program("record", overrides)
    assert isinstance(config, RecordConfig)
    return config


def test_the_first_success_is_the_default() -> None:
    assert record_settings().episode is None
    assert record_settings("episode=0").episode == 0
