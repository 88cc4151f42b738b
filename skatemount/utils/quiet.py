"""Warnings of libraries that a user can do nothing about."""

from __future__ import annotations

import re
import warnings
from typing import TextIO

_IGNORED = (
    re.compile(r"Creating \w*WeightUpdater which inherits from WeightUpdaterBase is deprecated"),
    re.compile(r".*X11: The DISPLAY environment variable is missing"),
)


def ignore_library_warnings() -> None:
    """Ignore TorchRL's warnings about its own weight updaters, and GLFW's that there is no display.

    A filter would not last: importing dm_control puts "always show" in front of all filters.
    """
    shown = warnings.showwarning
    if getattr(shown, "ignores_libraries", False):
        return

    def show(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        if not any(each.match(str(message)) for each in _IGNORED):
            shown(message, category, filename, lineno, file, line)

    show.ignores_libraries = True  # type: ignore[attr-defined]
    warnings.showwarning = show
