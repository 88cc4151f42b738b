"""The choice of an OpenGL library."""

from __future__ import annotations

import os

import pytest

from skatemount.rendering import opengl
from skatemount.utils.errors import ConfigError


@pytest.fixture(autouse=True)
def headless_linux(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.platform", "linux")
    for name in ("MUJOCO_GL", "DISPLAY", "WAYLAND_DISPLAY"):
        # Set first, so that what the code under test sets is undone as well.
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)


@pytest.mark.parametrize(("there", "chosen"), [({"egl", "osmesa", "glfw"}, "egl"), ({"osmesa"}, "osmesa")])
def test_the_first_that_works_is_chosen(there: set[str], chosen: str) -> None:
    assert opengl.choose(there.__contains__) == chosen
    assert os.environ["MUJOCO_GL"] == chosen


def test_a_window_library_needs_a_display(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError):
        opengl.choose({"glfw"}.__contains__)
    monkeypatch.setenv("DISPLAY", ":0")
    assert opengl.choose({"glfw"}.__contains__) == "glfw"


def test_what_to_install_is_said_in_a_line() -> None:
    with pytest.raises(ConfigError, match="apt install libegl1") as error:
        opengl.choose(lambda backend: False)
    assert "libosmesa6" in str(error.value)
    assert "\n" not in str(error.value)
    assert "MUJOCO_GL" not in os.environ


def test_a_choice_that_was_made_is_kept_if_it_works(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    assert opengl.choose({"egl", "osmesa"}.__contains__) == "osmesa"
    with pytest.raises(ConfigError, match="^MUJOCO_GL=osmesa cannot draw here"):
        opengl.choose({"egl"}.__contains__)


def test_other_systems_need_no_choice(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.platform", "darwin")
    assert opengl.choose(lambda backend: False) is None


def test_a_library_that_does_not_exist_does_not_work() -> None:
    assert not opengl.works("no_such_library")
