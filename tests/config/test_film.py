"""Settings of films."""

from __future__ import annotations

import pytest

from skatemount.config import RecordConfig, compose_program
from skatemount.utils.errors import ConfigError


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("film.width=641", "film.width=641 must be an even number of pixels"),
        ("film.height=100", "film.height=100 must be from 120 to 2160 pixels, an even number"),
        ("film.camera=left", "film.camera=left must be one of follow, side, top, fixed"),
        ("film.speed=0", "film.speed=0.0 must be from 0.05 to 20; 0.5 plays at half speed"),
        ("film.speed=nan", "film.speed=nan must be from 0.05 to 20"),
        ("episode=-1", "episode=-1 must be from 0 to"),
    ],
)
def test_refused_values_are_named(setting: str, message: str) -> None:
    with pytest.raises(ConfigError) as error:
        compose_program("record", [setting])
    assert message in str(error.value)
    assert "\n" not in str(error.value)


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
