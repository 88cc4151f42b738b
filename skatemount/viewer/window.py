"""MuJoCo's own window, for a machine with a display and without a browser."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from skatemount.viewer.measures import Pace
from skatemount.viewer.session import Session

SPACE, ENTER, BACKSPACE, RIGHT = 32, 257, 259, 262
"""GLFW's numbers of keys."""


class Window:
    """The selected world of a session in MuJoCo's window.

    Args:
        session: The session.
        launch: `mujoco.viewer.launch_passive`.
        clock: A steady clock, s.
    """

    def __init__(self, session: Session, launch: Callable[..., Any], clock: Callable[[], float] = time.perf_counter):
        self.session, self._launch = session, launch
        self.pace = Pace(clock)
        self._reported = ""
        self._model, self._data = session.env.physics.render_data(session.selected)
        self._handle = self._launch(
            self._model, self._data, key_callback=self.key, show_left_ui=False, show_right_ui=False
        )

    def key(self, code: int) -> None:
        """Handle a key; called in the window's thread."""
        session = self.session
        if code == SPACE:
            session.submit(lambda: setattr(session, "paused", not session.paused))
        elif code == RIGHT:
            session.submit(session.step_once)
        elif code in (BACKSPACE, ENTER):
            session.submit(session.reset)

    @property
    def is_open(self) -> bool:
        """True until the user closes the window."""
        return bool(self._handle.is_running())

    def turn(self) -> float:
        """Do what is due, and return the time until something is due again, s."""
        session = self.session
        session.work()
        if session.paused:
            self.pace.restart()
        elif not self.pace.wait():
            session.step()
            self.pace.stepped(session.env.mdp.context.control_step, session.speed)
        self._show()
        self._report()
        return 0.02 if session.paused else self.pace.wait()

    def _show(self) -> None:
        import mujoco

        qpos, mocap = self.session.env.physics.poses(slice(None))
        world = self.session.selected
        with self._handle.lock():
            self._data.qpos[:], self._data.mocap_pos[:] = qpos[world], mocap[world]
            mujoco.mj_kinematics(self._model, self._data)
        self._handle.sync()

    def _report(self) -> None:
        """Print the ends of episodes and errors, for which the window has no place."""
        session = self.session
        newest = session.ends[0] if session.ends else None
        text = session.error or session.message
        text = text or (f"world {newest.world}: {newest.words} after {newest.seconds:.2f} s" if newest else "")
        if text and text != self._reported:
            print(text, flush=True)
        self._reported = text

    def close(self) -> None:
        """Close the window."""
        self._handle.close()


def show(session: Session) -> None:
    """Play a session in MuJoCo's window until the user closes it.

    Args:
        session: The session.
    """
    import mujoco.viewer

    window = Window(session, mujoco.viewer.launch_passive)
    try:
        while window.is_open:
            time.sleep(window.turn())
    finally:
        window.close()
