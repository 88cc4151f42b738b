"""Choice of the OpenGL library. It precedes the import of mujoco and dm_control, which read it once."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable

from skatemount.utils.errors import ConfigError

VARIABLE = "MUJOCO_GL"
ADVICE = "On Debian or Ubuntu: apt install libegl1 libgl1-mesa-dri (EGL), or apt install libosmesa6 (OSMesa)"
_TRIAL = "import mujoco; c = mujoco.GLContext(16, 16); c.make_current(); c.free()"


def works(backend: str) -> bool:
    """Return whether a library can draw here; tried in a process of its own, because a failure may be a crash."""
    environment = {k: v for k, v in os.environ.items() if k != "PYOPENGL_PLATFORM"} | {VARIABLE: backend}
    try:
        trial = subprocess.run(
            [sys.executable, "-c", _TRIAL], env=environment, capture_output=True, timeout=120, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return trial.returncode == 0


def choose(works: Callable[[str], bool] = works) -> str | None:
    """Choose a library that can draw, and put it into ``MUJOCO_GL``.

    On Linux this tries EGL and OSMesa, which need no display, and then GLFW if there is a display. It keeps a choice
    that the variable already holds. Other systems need no choice.

    Args:
        works: Tells whether a library can draw.

    Returns:
        The choice, or none on a system that needs none.

    Raises:
        ConfigError: No library can draw; the line says what to install.
    """
    if chosen := os.environ.get(VARIABLE):
        if works(chosen):
            return chosen
        raise ConfigError(f"{VARIABLE}={chosen} cannot draw here; unset it to have one chosen. {ADVICE}")
    if not sys.platform.startswith("linux"):
        return None
    display = bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    for backend in ("egl", "osmesa", "glfw") if display else ("egl", "osmesa"):
        if works(backend):
            os.environ[VARIABLE] = backend
            return backend
    raise ConfigError(f"no OpenGL library that draws without a display was found. {ADVICE}")


def disable() -> None:
    """Keep mujoco and dm_control from looking for a display and from warning, in programs that draw nothing.

    A choice that ``MUJOCO_GL`` holds is replaced: one that does not exist here would make the import of mujoco fail.
    """
    os.environ[VARIABLE] = "disable"
