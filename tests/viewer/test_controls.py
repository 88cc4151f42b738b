"""Controls of the page, with a GUI that only notes what is added; `test_page` has them in a browser."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from unittest.mock import MagicMock

import pytest

from skatemount.config import compose_program
from skatemount.utils.errors import ConfigError
from skatemount.viewer.controls import Controls
from skatemount.viewer.session import Session


def shown(session: Session) -> tuple[Controls, dict[str, Any]]:
    """The controls of a session, and its folders by label."""
    gui, folders = MagicMock(), {}
    gui.add_folder.side_effect = lambda label: folders.setdefault(label, MagicMock())
    controls = Controls(gui, session, MagicMock(), lambda: None)
    controls.play_tab()
    controls.task_tab()
    controls.disturb_tab()
    return controls, folders


def test_a_ride_is_offered_only_where_the_task_rides(make_session: Callable[..., Session]) -> None:
    session = make_session("command=ride", "episode_length=1.4")
    controls, folders = shown(session)
    assert folders["Ride"].visible and not controls._velocity_keys.visible
    session.env.mdp.commands.rides = False  # as after the choice of another task
    controls.sync()
    assert not folders["Ride"].visible and controls._velocity_keys.visible
    assert not shown(make_session())[1]["Ride"].visible


def test_the_slider_has_the_worlds_that_the_setting_takes(make_session: Callable[..., Session]) -> None:
    session = make_session(worlds=1)
    controls, _ = shown(session)
    (slider,) = [call.args for call in controls._gui.add_slider.call_args_list if call.args[0] == "Worlds"]
    assert compose_program("play", [f"worlds={slider[2]}"]).worlds == slider[2]  # type: ignore[attr-defined]
    with pytest.raises(ConfigError):
        compose_program("play", [f"worlds={slider[2] + 1}"])
