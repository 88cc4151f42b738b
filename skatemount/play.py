"""`python -m skatemount.play checkpoint=...`: watch a policy live, and push it, in a browser."""

from __future__ import annotations

import contextlib
import os
from typing import TYPE_CHECKING

from skatemount.utils.signals import exiting_by_signals

if TYPE_CHECKING:
    from skatemount.config import PlayConfig
    from skatemount.viewer.session import Session
    from skatemount.viewer.watch import RunWatcher


def play(config: PlayConfig, overrides: list[str]) -> None:
    """Let a policy act live until the program is asked to end.

    Settings: ``checkpoint`` (or ``pipeline``, or ``run``), ``suite`` and ``seed`` as for `skatemount.evaluate`,
    ``agent``, ``worlds``, ``speed``, ``viewer``, ``watch``, ``host``, ``port``, ``open_browser``, and any setting of
    the task; see `skatemount.config.programs.PlayConfig`.

    Args:
        config: As composed from the command line.
        overrides: The settings that the user gave.

    Raises:
        ConfigError: There is no such policy, run or suite, the policy does not fit the task, or the viewer cannot be
            opened.
    """
    from skatemount.evaluation.suite_task import EvaluationTask
    from skatemount.runs.find import find_checkpoint
    from skatemount.utils.errors import ConfigError
    from skatemount.viewer import server
    from skatemount.viewer.session import Session
    from skatemount.viewer.watch import RunWatcher, find_run

    if given := [each for each in overrides if each.lstrip("+").startswith("physics.num_worlds=")]:
        raise ConfigError(f"{given[0]}: worlds=<number> sets the number of worlds of play")
    viewer = choose_viewer(config.viewer, server.is_installed(), server.has_display())
    watcher = None
    if config.run is not None:
        if chosen := [each for each in overrides if each.startswith("checkpoint=")]:
            raise ConfigError(f"{chosen[0]} with run={config.run}: leave out one of the two")
        if config.watch:
            watcher = RunWatcher(find_run(config.run, config.logger.root))
            watcher.wait_for_checkpoint()
            # The training comes first.
            if hasattr(os, "nice"):
                os.nice(10)
        config.checkpoint = str(watcher.run if watcher else find_checkpoint(config.run, config.logger.root, "run"))
    (task,) = EvaluationTask.prepare(config, overrides)
    session = Session(task, config.agent, config.worlds, config.speed, config.logger.root)
    with contextlib.closing(session):
        print(f"{session.policy_name} on {session.config_name}, seed {config.seed}", flush=True)
        if viewer == "native":
            _show_window(session)
        else:
            _show_page(session, watcher, config)


def choose_viewer(viewer: str, installed: bool, display: bool) -> str:
    """Return the viewer to open, ``page`` or ``native``.

    Args:
        viewer: The setting.
        installed: True if the libraries of the page are installed.
        display: True if a window can be opened.

    Raises:
        ConfigError: The viewer cannot be opened here.
    """
    from skatemount.utils.errors import ConfigError

    missing = "the page needs viser and mjviser: pip install 'skatemount[play]'"
    if viewer == "page" and not installed:
        raise ConfigError(f"viewer=page: {missing}")
    if viewer == "native" and not display:
        raise ConfigError("viewer=native needs a display, and DISPLAY is not set; viewer=page needs only a browser")
    if viewer == "auto" and not installed and not display:
        raise ConfigError(f"viewer=auto: there is no display for a window, and {missing}")
    return viewer if viewer != "auto" else "page" if installed else "native"


def _show_page(session: Session, watcher: RunWatcher | None, config: PlayConfig) -> None:
    from skatemount.viewer import server
    from skatemount.viewer.page import Page

    found, address = server.start(config.host, config.port)
    page = Page(found, session, watcher, config.plain)
    with contextlib.closing(page):
        print(f"open {address} in a browser; Ctrl-C ends", flush=True)
        if config.open_browser:
            server.open_in_browser(address)
        page.run()


def _show_window(session: Session) -> None:
    from skatemount.viewer.window import show

    print("space pauses, right arrow steps, backspace resets; close the window to end", flush=True)
    show(session)


def main() -> None:
    """Run the program."""
    with exiting_by_signals("play"):
        from skatemount.rendering import opengl

        # The page draws in the browser, and MuJoCo's window brings its own OpenGL.
        opengl.disable()
        from skatemount import cli

        cli.run(play, "play")


if __name__ == "__main__":
    main()
