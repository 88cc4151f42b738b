"""Standard output and error that never end a program: any encoding, closed pipes, full disks."""

from __future__ import annotations

import codecs
import contextlib
import errno
import os
import sys
from collections.abc import Iterator
from typing import Any, TextIO

_IN_ASCII = {"─": "-", "━": "-", "–": "-", "—": "-", "…": "...", "±": "+-", "×": "x", "°": " deg", "≥": ">=", "≤": "<="}


def _replace(error: UnicodeError) -> tuple[str, int]:
    """Replace what an encoding does not have, by something similar where there is such."""
    assert isinstance(error, UnicodeEncodeError)
    return "".join(_IN_ASCII.get(c, "?") for c in error.object[error.start : error.end]), error.end


codecs.register_error("skatemount.similar", _replace)


class SafeStream:
    """Text stream that drops its output from the moment at which it cannot be written; everything else is the file's.

    Args:
        file: The file.
        live: Let `isatty` say what the file says; else it is False.
    """

    def __init__(self, file: TextIO, live: bool = True) -> None:
        self._file = file
        self._live = live
        self._lost = False

    def write(self, text: str) -> int:
        """Write text, if it can be written."""
        if not self._lost:
            try:
                self._file.write(text)
            except OSError as error:
                self._lose(error)
        return len(text)

    def writelines(self, lines: list[str]) -> None:
        """Write lines, if they can be written."""
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        """Flush what can be written."""
        if not self._lost:
            try:
                self._file.flush()
            except OSError as error:
                self._lose(error)

    def isatty(self) -> bool:
        """Return whether it is a terminal that one process writes to."""
        return self._live and self._file.isatty()

    def _lose(self, error: OSError) -> None:
        """Let the rest of the output go nowhere."""
        self._lost = True
        with contextlib.suppress(OSError, ValueError):
            # What the file's own buffer holds is written at exit, and must not fail again.
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self._file.fileno())
            os.close(nowhere)
        gone = isinstance(error, BrokenPipeError) or error.errno == errno.EIO
        if not gone and self._file is not sys.__stderr__:
            print(f"output is lost from here on: {error.strerror}", file=sys.stderr)

    def __getattr__(self, name: str) -> Any:
        """Return any other attribute of the file."""
        return getattr(self._file, name)


@contextlib.contextmanager
def safe_streams(live: bool = True) -> Iterator[None]:
    """Make standard output and error safe for the time of a block, and flush them at its end.

    Args:
        live: Let the output be a terminal; False in a process that shares the terminal with others.
    """
    before = sys.stdout, sys.stderr
    made = []
    for file in before:
        if file is None:
            # The descriptor was closed before the program began.
            file = open(os.devnull, "w", encoding="utf-8")
        if isinstance(file, SafeStream):
            made.append(file if live else SafeStream(file._file, live))
            continue
        with contextlib.suppress(AttributeError, ValueError, OSError):
            file.reconfigure(errors="skatemount.similar")  # type: ignore[union-attr]
        made.append(SafeStream(file, live))
    sys.stdout, sys.stderr = made
    try:
        yield
    finally:
        for stream in made:
            stream.flush()
        sys.stdout, sys.stderr = before
