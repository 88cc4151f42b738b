"""`python -m skatemount.play`, without a browser."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from skatemount.config import compose_program
from skatemount.play import choose_viewer, play
from skatemount.utils.errors import ConfigError
from skatemount.viewer import server


@pytest.mark.parametrize(
    ("viewer", "installed", "display", "expected"),
    [
        ("auto", True, False, "page"),
        ("auto", True, True, "page"),
        ("auto", False, True, "native"),
        ("page", True, True, "page"),
        ("native", True, True, "native"),
        ("auto", False, False, "viewer=auto: there is no display"),
        ("page", False, True, "viewer=page: the page needs viser"),
        ("native", True, False, "viewer=native needs a display"),
    ],
)
def test_the_viewer_that_can_be_opened_is_chosen(viewer: str, installed: bool, display: bool, expected: str) -> None:
    if expected in ("page", "native"):
        assert choose_viewer(viewer, installed, display) == expected
        return
    with pytest.raises(ConfigError, match=expected) as error:
        choose_viewer(viewer, installed, display)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (["worlds=0"], "worlds=0 must be from 1 to 256"),
        (["speed=5"], "speed=5.0 must be from 0.0625 to 4"),
        (["port=0"], "port=0 must be from 1 to 65535"),
        (["agent=clever"], "agent=clever must be one of trained, zero, random"),
        (["viewer=web"], "viewer=web must be one of auto, page, native"),
        (["suite=all"], "suite=all: name one to play in, of"),
        (["watch=true"], "watch=true needs the run to follow, such as run=latest"),
        (["run=latest", "watch=true", "viewer=native"], "watch=true shows curves"),
        (["run=latest", "pipeline=gait+mount"], "run=latest with pipeline=gait+mount: leave out one"),
    ],
)
def test_settings_that_cannot_be_used(settings: list[str], said: str) -> None:
    with pytest.raises(ConfigError) as error:
        compose_program("play", settings)
    assert said in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (["physics.num_worlds=8"], "worlds=<number> sets the number of worlds"),
        (["run=latest", "checkpoint=best"], "checkpoint=best with run=latest: leave out one"),
        (["run=latest"], "run=latest: no run in"),
        (["run=latest", "watch=true"], "run=latest: there is no run in"),
    ],
)
def test_what_cannot_be_played(
    settings: list[str], said: str, runs_root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "is_installed", lambda: True)
    with pytest.raises(ConfigError, match=said):
        play(compose_program("play", settings), settings)


def test_the_session_gets_the_settings(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], runs_root: Path
) -> None:
    seen: list[Any] = []
    monkeypatch.setattr(server, "is_installed", lambda: False)
    monkeypatch.setattr(server, "has_display", lambda: True)
    monkeypatch.setattr("skatemount.play._show_window", seen.append)
    given = ["checkpoint=pretrained:balance", "suite=balance-fixed", "worlds=3", "speed=0.5", "agent=zero", "seed=4"]
    play(compose_program("play", given), given)
    (session,) = seen
    assert (session.worlds, session.speed, session.agent, session.task.seed) == (3, 0.5, "zero", 4)
    assert session.env.is_closed
    assert capsys.readouterr().out.startswith("zero on balance-fixed, seed 4\n")
