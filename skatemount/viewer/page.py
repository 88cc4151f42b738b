"""The page: a session in the browser."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from skatemount.viewer import texts
from skatemount.viewer.controls import Controls
from skatemount.viewer.measures import Pace
from skatemount.viewer.poses import feet
from skatemount.viewer.scene import SceneView
from skatemount.viewer.session import Session

if TYPE_CHECKING:
    from skatemount.viewer.watch import RunWatcher

FRAME = 1 / 30
"""Least time between two pictures, s."""

TEXT = 0.25
"""Least time between two updates of texts and curves, s."""

CURVES = 6
"""Number of reward terms that are drawn."""

FRAMES = "million frames"
COLORS = ("#e6194b", "#3cb44b", "#4363d8", "#f58231", "#911eb4", "#008080")


class Page:
    """The page of a session.

    Args:
        server: The viser server.
        session: The session.
        watcher: Follows a training; None without one.
        plain: Draw without shadows and reflections.
        clock: A steady clock, s.
    """

    def __init__(
        self,
        server: Any,
        session: Session,
        watcher: RunWatcher | None = None,
        plain: bool = False,
        clock: Callable[[], float] = time.perf_counter,
    ):
        self.server, self.session, self._clock = server, session, clock
        self.view = SceneView(server, session, plain)
        self.pace = Pace(clock)
        self._watcher = watcher
        self._drawn = self._written = -1.0
        self._plotted: list[str] = []
        gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.set_panel_label("skatemount")
        gui.main_panel.dock_right()
        gui.main_panel.set_width(400)
        self._status = gui.add_html("")
        controls = self.controls = Controls(gui, session, self.view, self._aim)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Play"):
            controls.play_tab()
        with tabs.add_tab("Task"):
            controls.task_tab()
        with tabs.add_tab("Disturb"):
            controls.disturb_tab()
        with tabs.add_tab("Numbers"):
            self._numbers()
        if watcher is not None:
            with tabs.add_tab("Training"):
                self._training_tab(watcher)
        server.on_client_connect(self.view.place_camera)

    def _numbers(self) -> None:
        gui = self.server.gui
        with gui.add_folder("Feet and board"):
            self._contacts = gui.add_html("")
            forces = gui.add_checkbox("Show contact forces", True)
            forces.on_update(lambda _: setattr(self.view, "show_forces", forces.value))
            sensed = gui.add_checkbox("Show the board as it is sensed", True)
            sensed.on_update(lambda _: setattr(self.view, "show_sensed", sensed.value))
        with gui.add_folder("Reward terms (per second)"):
            self._filter = gui.add_text("Filter", "", hint=f"Parts of names; empty: the {CURVES} largest terms")
            self._plot = gui.add_uplot(
                (np.zeros(2), *[np.zeros(2)] * CURVES), curves([]), scales={"x": {"time": False}}, height=260
            )
        with gui.add_folder("Last episodes"):
            self._ends = gui.add_html("")

    def _training_tab(self, watcher: RunWatcher) -> None:
        gui = self.server.gui
        self._training_curves = {}
        for title, metrics in watcher.plots().items():
            plot = gui.add_uplot(
                on_one_axis([], len(metrics)),
                curves([], FRAMES, len(metrics)),
                title=title,
                scales={"x": {"time": False}},
                height=200,
            )
            self._training_curves[title] = (plot, metrics)
        self._picture = gui.add_image(np.full((1, 1, 3), 255, np.uint8), label="Success map", visible=False)
        self._training = gui.add_html("")

    @property
    def watched(self) -> bool:
        """True if a browser shows the page."""
        return bool(self.server.get_clients())

    def turn(self) -> float:
        """Do what is due, and return the time until something is due again, s."""
        session, pace = self.session, self.pace
        if self._watcher is not None:
            self._follow(self._watcher)
        acted = session.work()
        if acted:
            self.view.stepped()
            self.controls.sync()
        if not self.watched:
            # Nothing is computed for nobody.
            pace.restart()
            return 0.1
        if session.paused:
            pace.restart()
        elif not pace.wait():
            session.step()
            self.view.stepped()
            pace.stepped(session.env.mdp.context.control_step, session.speed)
            if session.paused:
                self.controls.sync()
        self._show(acted)
        due = 0.03 if session.paused else min(pace.wait(), FRAME)
        return max(due, 0.0)

    def _show(self, now: bool) -> None:
        session, at = self.session, self._clock()
        if now or at - self._drawn >= FRAME:
            step = session.env.mdp.context.control_step / session.speed
            passed = 1.0 if session.paused or step < 2 * FRAME else 1 - min(1.0, self.pace.wait() / step)
            self.view.show(passed)
            self._drawn = at
        if now or at - self._written >= TEXT:
            self._write()
            self._written = at

    def _write(self) -> None:
        """Write the texts and curves."""
        session = self.session
        _put(self._status, texts.status(session, self.pace.speed))
        _put(self._contacts, texts.contacts(session, feet(session, session.selected)[0]))
        _put(self._ends, texts.ends(session.ends))
        self._draw_curves()

    def _draw_curves(self) -> None:
        history, world = self.session.rewards, self.session.selected
        times, values = history.curves(world)
        chosen = history.chosen(world, self._filter.value, CURVES)
        if len(times) < 2 or not chosen:
            return
        # In the order of the table, so that curves keep their colors while their sizes change.
        chosen = sorted(chosen)
        names = [history.names[i] for i in chosen]
        if names != self._plotted:
            self._plot.series = curves(names)
            self._plotted = names
        missing = [np.full(len(times), np.nan)] * (CURVES - len(names))
        self._plot.data = (times, *(values[i] for i in chosen), *missing)

    def _follow(self, watcher: RunWatcher) -> None:
        """Show the new files of a training."""
        if watcher.poll(self.session):
            for plot, metrics in self._training_curves.values():
                found = watcher.tail.curves(metrics)
                plot.series = curves([metrics[name] for name in found], FRAMES, len(metrics))
                plot.data = on_one_axis(list(found.values()), len(metrics))
        _put(self._training, watcher.text)
        if (picture := watcher.new_picture()) is not None:
            self._picture.image = picture
            self._picture.visible = True

    def _aim(self) -> None:
        for client in self.server.get_clients().values():
            self.view.place_camera(client)

    def run(self) -> None:
        """Play until the program is asked to end."""
        while True:
            time.sleep(self.turn())

    def close(self) -> None:
        """Stop the server and close the worlds."""
        self.server.stop()
        self.session.close()


def curves(names: Sequence[str], along: str = "time (s)", number: int = CURVES) -> tuple[dict[str, Any], ...]:
    """Return uPlot's description of an x axis and some curves, of which those without a name are not shown."""
    found: list[dict[str, Any]] = [{"label": along}]
    for i, color in enumerate(COLORS[:number]):
        name = names[i] if i < len(names) else ""
        found.append({"label": name, "stroke": color, "width": 2, "show": bool(name)})
    return tuple(found)


def on_one_axis(found: Sequence[tuple[np.ndarray, np.ndarray]], number: int) -> tuple[np.ndarray, ...]:
    """Return curves for uPlot, which wants every curve at the same places and draws none with a gap.

    Args:
        found: Places and values of each curve. Between its values a curve is a straight line.
        number: Number of curves to return, of which those that are missing are zero.

    Returns:
        The places of all curves together, and the values of each curve there.
    """
    if not found:
        return tuple([np.zeros(2)] * (1 + number))
    places = np.unique(np.concatenate([x for x, _ in found]))
    values = [np.interp(places, x, y) for x, y in found]
    return (places, *values, *[np.zeros(len(places))] * (number - len(found)))


def _put(handle: Any, content: str) -> None:
    """Write the content of an HTML element if it has changed."""
    if handle.content != content:
        handle.content = content
