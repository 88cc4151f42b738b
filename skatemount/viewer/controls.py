"""Controls of the page: they turn clicks and keys into actions of a session."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from skatemount.config.files import choices, suites
from skatemount.config.programs import MAX_WORLDS
from skatemount.viewer.actors import checkpoints_of, known_policies
from skatemount.viewer.conditions import ChosenStart, Conditions
from skatemount.viewer.scene import CAMERAS, SceneView
from skatemount.viewer.session import Session

SPEEDS = {"1/16": 1 / 16, "1/8": 1 / 8, "1/4": 1 / 4, "1/2": 1 / 2, "1": 1.0, "2": 2.0, "4": 4.0}
"""Speeds that can be chosen, by their labels."""

OWN_TASK = "its own task"
OWN_BOARD = "the task's"

KEYS = {"I": (0.1, 0.0, 0.0), "K": (-0.1, 0.0, 0.0), "J": (0.0, 0.0, 0.2), "L": (0.0, 0.0, -0.2), "U": (0.0, 0.1, 0.0),
        "O": (0.0, -0.1, 0.0)}  # fmt: skip
"""Change of the velocity command by key: forward and left, m/s, turn left, rad/s."""

LIMITS = (1.5, 1.0, 2.0)
"""Largest velocity command of the sliders."""

RIDE_KEYS = {"I": (0.1, 0.0), "K": (-0.1, 0.0), "J": (0.0, 0.1), "L": (0.0, -0.1), "U": None, "O": None}
"""Change of the command of a ride by key: speed, m/s, and share of the largest curvature; None for straight on."""


class Controls:
    """Buttons, sliders and keys of the page.

    Args:
        gui: The GUI of the viser server.
        session: The session that they act on.
        view: The scene.
        aim: Called after the camera was changed.
    """

    def __init__(self, gui: Any, session: Session, view: SceneView, aim: Callable[[], None]):
        self._gui, self._session, self._view, self._aim = gui, session, view, aim
        self._syncing = False

    def play_tab(self) -> None:
        """Add pause, step, reset, speed, seed, worlds and camera."""
        gui, session, submit = self._gui, self._session, self._session.submit
        self._pause = gui.add_button("Pause", icon=None)
        self._pause.on_click(lambda _: submit(self._toggle))
        gui.add_button("Single step").on_click(lambda _: submit(session.step_once))
        gui.add_button("Reset").on_click(lambda _: submit(session.reset))
        speed = gui.add_dropdown("Speed", list(SPEEDS), initial_value=nearest_speed(session.speed))
        speed.on_update(lambda _: self._set("speed", SPEEDS[speed.value]))
        self._seed = gui.add_number("Seed", session.task.seed, min=0, step=1)
        self._seed.on_update(self._when_user(lambda: session.reseed(int(self._seed.value)), "seed"))
        worlds = gui.add_slider("Worlds", 1, MAX_WORLDS, 1, session.worlds)
        worlds.on_update(lambda _: submit(lambda: self._choose_worlds(int(worlds.value)), "worlds"))
        self._shown = gui.add_slider("Show world", 0, max(1, session.worlds - 1), 1, 0)
        self._shown.on_update(self._when_user(lambda: self._select(int(self._shown.value)), "world"))
        only = gui.add_checkbox("Hide other worlds", False)
        only.on_update(lambda _: submit(lambda: setattr(self._view, "only_selected", only.value), "only"))
        stop = gui.add_checkbox("Pause at the end of an episode", False)
        stop.on_update(lambda _: self._set("pause_at_end", stop.value))
        camera = gui.add_button_group("Camera", list(CAMERAS))
        camera.on_click(lambda _: submit(lambda: self._choose_camera(camera.value), "camera"))
        plain = gui.add_checkbox("Plain drawing", self._view.plain, hint="Faster in a browser without a GPU")
        plain.on_update(lambda _: submit(lambda: self._view.set_plain(plain.value), "plain"))
        self._keys()

    def task_tab(self) -> None:
        """Add policy, suite, board and start."""
        gui, session, submit = self._gui, self._session, self._session.submit
        with gui.add_folder("Policy"):
            offered = known_policies(session.root)
            now = session.task.agent.spec if session.agent == "trained" else session.agent
            self._policy = gui.add_dropdown("Policy", list(dict.fromkeys([now, *offered])), initial_value=now)
            self._policy.on_update(
                self._when_user(lambda: self._choose_policy(self._policy.value, refresh=True), "policy")
            )
            self._checkpoint = gui.add_dropdown("Checkpoint", ["latest"], visible=False)
            self._checkpoint.on_update(self._when_user(lambda: self._choose_policy(self._checkpoint.value), "policy"))
            other = gui.add_text("Other", "", hint="A run, a checkpoint, a file, latest or best")
            gui.add_button("Load").on_click(
                lambda _: submit(lambda: self._choose_policy(other.value.strip(), refresh=True), "policy")
            )
        with gui.add_folder("Task"):
            known = [name for name in suites() if name != "all"]
            first = OWN_TASK if session.task.suite is None else session.task.suite.name
            suite = gui.add_dropdown("Suite", list(dict.fromkeys([OWN_TASK, first, *known])), initial_value=first)
            suite.on_update(
                lambda _: submit(
                    lambda: session.choose_suite(None if suite.value == OWN_TASK else suite.value), "suite"
                )
            )
            self._variant = gui.add_dropdown("Variant", list(session.task.configs), visible=False)
            self._variant.on_update(self._when_user(lambda: session.choose_variant(self._variant.value), "variant"))
            board = gui.add_dropdown("Board", [OWN_BOARD, *choices("board")], initial_value=OWN_BOARD)
            board.on_update(
                lambda _: submit(lambda: session.choose_board("" if board.value == OWN_BOARD else board.value), "board")
            )
        with gui.add_folder("Start"):
            self._start_controls()
        self._list_checkpoints()

    def _start_controls(self) -> None:
        gui, usual = self._gui, ChosenStart()
        own = gui.add_checkbox("Choose the start", False)
        sliders = {
            "distance": gui.add_slider("Distance (m)", 0.0, 4.0, 0.05, usual.distance),
            "bearing": gui.add_slider("Bearing (°)", -180.0, 180.0, 5.0, usual.bearing),
            "heading": gui.add_slider("Heading (°)", -180.0, 180.0, 5.0, usual.heading),
            "board_speed": gui.add_slider("Board's speed (m/s)", -1.0, 1.0, 0.05, usual.board_speed),
            "board_fixed": gui.add_checkbox("Fixed board", usual.board_fixed),
        }

        def changed(event: Any) -> None:
            if own.value:
                start = ChosenStart(**{name: slider.value for name, slider in sliders.items()})
                self._session.submit(lambda: self._session.choose_start(start), "start")
            elif event.target is own:
                self._session.submit(lambda: self._session.choose_start(None), "start")

        for control in (own, *sliders.values()):
            control.on_update(changed)

    def disturb_tab(self) -> None:
        """Add pushes, delays, noise, friction and commands."""
        gui, session, submit = self._gui, self._session, self._session.submit
        with gui.add_folder("Push"):
            self._push_speed = gui.add_slider("Push (m/s)", 0.0, 3.0, 0.1, 0.5)
            self._push_angle = gui.add_slider("Direction (°)", -180.0, 180.0, 15.0, 90.0, hint="0 is forward")
            self._push_all = gui.add_checkbox("Push every world", True)
            gui.add_button("Push robot").on_click(lambda _: submit(lambda: self._push(board=False)))
            gui.add_button("Push board").on_click(lambda _: submit(lambda: self._push(board=True)))
        with gui.add_folder("Conditions"):
            own = gui.add_checkbox("Choose the conditions", False)
            sliders = {
                "target_delay": gui.add_slider("Delay of targets (ms)", 0, 100, 10, 0),
                "latency": gui.add_slider("Age of observations (steps)", 0, 6, 1, 0),
                "noise": gui.add_slider("Noise (1: sensing=default)", 0.0, 3.0, 0.1, 0.0),
                "friction": gui.add_slider("Friction (factor)", 0.1, 2.0, 0.05, 1.0),
            }

            def changed(event: Any) -> None:
                if not own.value and event.target is not own:
                    return
                values = {name: slider.value for name, slider in sliders.items()}
                values["target_delay"] = values["target_delay"] / 1000
                conditions = Conditions(**values) if own.value else Conditions()
                submit(lambda: session.change_conditions(conditions), "conditions")

            for control in (own, *sliders.values()):
                control.on_update(changed)
        with gui.add_folder("Velocity command"):
            self._own_command = gui.add_checkbox("Choose the command", False)
            names = ("Forward (m/s)", "Left (m/s)", "Turn left (rad/s)")
            self._command = [gui.add_slider(name, -most, most, 0.05, 0.0) for name, most in zip(names, LIMITS)]
            for each in (self._own_command, *self._command):
                each.on_update(self._when_user(self._give_command, "command"))
            self._velocity_keys = gui.add_markdown(
                "Keys: **I** and **K** forward and back, **J** and **L** turn, **U** and **O** sideways."
            )
        self._ride_folder = gui.add_folder("Ride")
        with self._ride_folder:
            self._own_ride = gui.add_checkbox("Drive the board", False)
            self._ride = [
                gui.add_slider("Ride at (m/s)", 0.0, 2.0, 0.05, 1.0),
                gui.add_slider("Curve to the left", -1.0, 1.0, 0.05, 0.0, hint="Share of the tightest curve"),
            ]
            for each in (self._own_ride, *self._ride):
                each.on_update(self._when_user(self._give_ride, "command"))
            gui.add_markdown("Keys: **I** and **K** faster and slower, **J** and **L** left and right, **U** straight.")
        self._show_commands()

    def sync(self) -> None:
        """Show what an action has changed."""
        session = self._session
        self._syncing = True
        try:
            label = "Resume" if session.paused else "Pause"
            if self._pause.label != label:
                self._pause.label = label
            variants = list(session.task.configs)
            if list(self._variant.options) != variants:
                self._variant.options = variants
                self._variant.visible = len(variants) > 1
            self._show_commands()
        finally:
            self._syncing = False

    def _show_commands(self) -> None:
        """Show the ride where the task has rides, and the keys of the velocity where they mean it."""
        rides = self._rides
        self._ride_folder.visible, self._velocity_keys.visible = rides, not rides

    def list_checkpoints(self) -> None:
        """Offer the checkpoints of the run that the policy is of."""
        self._syncing = True
        try:
            self._list_checkpoints()
        finally:
            self._syncing = False

    def _list_checkpoints(self) -> None:
        agent = self._session.task.agent
        found = checkpoints_of(agent.path)
        self._checkpoint.visible = bool(found)
        if found:
            self._checkpoint.options = found
            if str(agent.path) in found:
                self._checkpoint.value = str(agent.path)

    def _keys(self) -> None:
        gui, session, submit = self._gui, self._session, self._session.submit
        actions: dict[str, tuple[str, Callable[[], None]]] = {
            "space": ("Pause or resume", self._toggle),
            "enter": ("Reset", session.reset),
            "N": ("Single step", session.step_once),
            "P": ("Push robot", lambda: self._push(board=False)),
            "B": ("Push board", lambda: self._push(board=True)),
            "pagedown": ("Next world", lambda: self._select((session.selected + 1) % session.worlds)),
            "pageup": ("Previous world", lambda: self._select((session.selected - 1) % session.worlds)),
        }
        for key, (label, action) in actions.items():
            gui.add_command(label, hotkey=key).on_trigger(lambda _, action=action: submit(action))
        for key, change in KEYS.items():
            command = gui.add_command(f"Velocity command {change}, or that of the ride", hotkey=key)
            command.on_trigger(lambda _, key=key: submit(lambda: self._press(key)))

    # The rest runs in the session's thread.

    def _when_user(self, action: Callable[[], None], key: str) -> Callable[[Any], None]:
        """Return a callback that submits an action unless the page itself has changed the control."""

        def callback(event: Any) -> None:
            if not self._syncing and event.client is not None:
                self._session.submit(action, key)

        return callback

    def _set(self, name: str, value: object) -> None:
        self._session.submit(lambda: setattr(self._session, name, value), name)

    def _toggle(self) -> None:
        self._session.paused = not self._session.paused

    def _choose_worlds(self, number: int) -> None:
        self._session.choose_worlds(number)
        self._shown.max = max(1, number - 1)
        self._shown.value = self._session.selected

    def _select(self, world: int) -> None:
        self._session.selected = min(world, self._session.worlds - 1)
        self._shown.value = self._session.selected

    def _choose_camera(self, name: str) -> None:
        self._view.camera = name
        self._aim()

    def _choose_policy(self, spec: str, refresh: bool = False) -> None:
        self._session.choose_policy(spec)
        if refresh:
            self.list_checkpoints()

    def _push(self, board: bool) -> None:
        self._session.push(self._push_speed.value, self._push_angle.value, board, self._push_all.value)

    def _give_command(self) -> None:
        values = [slider.value for slider in self._command]
        self._session.choose_command((values[0], values[1], values[2]) if self._own_command.value else None)

    def _give_ride(self) -> None:
        values = [slider.value for slider in self._ride]
        self._session.choose_command((values[0], values[1]) if self._own_ride.value else None)

    def _press(self, key: str) -> None:
        """Change the command by a key: that of a ride where the task has rides, else the velocity."""
        if self._rides:
            self._change_ride(RIDE_KEYS[key])
        else:
            self._change_command(KEYS[key])

    @property
    def _rides(self) -> bool:
        return bool(self._session.env.mdp.commands.rides)

    def _change_ride(self, change: tuple[float, float] | None) -> None:
        speed, curve = self._ride
        if change is None:
            curve.value = 0.0
        else:
            speed.value = round(max(speed.min, min(speed.max, speed.value + change[0])), 2)
            curve.value = round(max(curve.min, min(curve.max, curve.value + change[1])), 2)
        self._own_ride.value = True
        self._give_ride()

    def _change_command(self, change: tuple[float, float, float]) -> None:
        for slider, step, most in zip(self._command, change, LIMITS):
            slider.value = round(max(-most, min(most, slider.value + step)), 2)
        self._own_command.value = True
        self._give_command()


def nearest_speed(speed: float) -> str:
    """Return the label of the speed that comes nearest to one."""
    return min(SPEEDS, key=lambda label: abs(SPEEDS[label] - speed))
