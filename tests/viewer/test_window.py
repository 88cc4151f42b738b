from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from skatemount.viewer.session import Session
from skatemount.viewer.window import RIGHT, SPACE, Window


class Handle:
    """MuJoCo's window without a display: it notes what it would show."""

    def __init__(self, model: Any, data: Any, key_callback: Callable[[int], None], **options: bool):
        self.model, self.data, self.press, self.options = model, data, key_callback, options
        self.shown: list[np.ndarray] = []
        self.running = True

    def is_running(self) -> bool:
        return self.running

    def lock(self) -> contextlib.AbstractContextManager[None]:
        return contextlib.nullcontext()

    def sync(self) -> None:
        self.shown.append(self.data.qpos.copy())

    def close(self) -> None:
        self.running = False


def test_the_window_shows_the_selected_world_and_takes_keys(
    make_session: Callable[..., Session], capsys: pytest.CaptureFixture[str]
) -> None:
    session, now = make_session("episode_length=0.2"), 0.0
    handles: list[Handle] = []

    def launch(*arguments: Any, **options: Any) -> Handle:
        handles.append(Handle(*arguments, **options))
        return handles[-1]

    window = Window(session, launch, lambda: now)
    (handle,) = handles
    wait = window.turn()
    assert wait == pytest.approx(0.04) and session.time == pytest.approx(0.04)
    window.turn()
    assert session.time == pytest.approx(0.04)  # not due yet
    np.testing.assert_array_equal(handle.shown[-1], session.env.physics.poses(slice(None))[0][0])
    handle.press(SPACE)
    window.turn()
    assert session.paused
    handle.press(RIGHT)
    window.turn()
    assert session.time == pytest.approx(0.08)
    handle.press(SPACE)
    for _ in range(5):
        window.turn()
        now += 0.04
    assert "world 1: not mounted at the time limit after 0.20 s" in capsys.readouterr().out
    assert window.is_open
    window.close()
    assert not window.is_open
