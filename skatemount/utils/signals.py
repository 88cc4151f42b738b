"""Requests to end a program: Ctrl-C, SIGTERM, SIGHUP, and SIGUSR1 all raise `Ended`, once.

The first signal raises `Ended` in the main thread. A second one changes nothing, so that it cannot cost what the
program saves at its end. A third one ends the process at once.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from types import FrameType

NAMES = ("SIGINT", "SIGTERM", "SIGHUP", "SIGUSR1")
"""Signals that ask a program to end; systems without one of them ignore its name."""


class Ended(KeyboardInterrupt):
    """A signal asked the program to end.

    Attributes:
        signum: Number of the signal.
        left: What the program leaves behind and how to go on, for the user; an empty string if there is nothing.
    """

    def __init__(self, signum: int, left: str = "") -> None:
        super().__init__(signum, left)
        self.signum = signum
        self.left = left

    @property
    def status(self) -> int:
        """Exit status of a program that the signal ends."""
        return 128 + self.signum

    def __str__(self) -> str:
        return f"ended by {signal.Signals(self.signum).name}" + (f"; {self.left}" if self.left else "")


class _Requests:
    """The signals that have come in, and whether they have to wait."""

    def __init__(self) -> None:
        self.received: list[int] = []
        self.shields = 0
        self.waiting = False

    def handle(self, signum: int, frame: FrameType | None) -> None:
        """Handle a signal; runs in the main thread."""
        self.received.append(signum)
        if len(self.received) > 2:
            # Without any clean-up, which may be what hangs.
            os._exit(128 + signum)
        if len(self.received) == 2:
            with contextlib.suppress(OSError, ValueError):
                print("ending already; once more ends at once, without saving", file=sys.stderr, flush=True)
        elif self.shields:
            self.waiting = True
        else:
            raise Ended(signum)


_requests: _Requests | None = None


@contextlib.contextmanager
def ending_by_signals() -> Iterator[None]:
    """Raise `Ended` in a ``with`` block when a signal asks the program to end.

    Blocks may be nested: only the outermost one installs and removes the handlers. Outside of the main thread, which
    signals belong to, it does nothing.
    """
    global _requests
    if _requests is not None or threading.current_thread() is not threading.main_thread():
        yield
        return
    requests = _requests = _Requests()
    before = {}
    try:
        for name in NAMES:
            if (signum := getattr(signal, name, None)) is not None:
                before[signum] = signal.signal(signum, requests.handle)
        yield
    finally:
        for signum, handler in before.items():
            # None stands for a handler that was not installed from Python.
            signal.signal(signum, signal.SIG_DFL if handler is None else handler)
        _requests = None


class EvaluationEnded(Exception):
    """A signal waits until the present iteration is saved, so the evaluation does not go on."""


def waiting_signal() -> int:
    """Return the number of a signal that waits until the end of a `shielded` block; 0 if there is none."""
    return _requests.received[0] if _requests is not None and _requests.waiting else 0


@contextlib.contextmanager
def exiting_by_signals(program: str) -> Iterator[None]:
    """End the process with one line and the usual status when a signal asks for it; for the ``main`` of a program.

    Args:
        program: Name of the program, for the line.
    """
    with ending_by_signals():
        try:
            yield
        except KeyboardInterrupt as error:
            end = error if isinstance(error, Ended) else Ended(signal.SIGINT)
            # The terminal may be gone, which is what SIGHUP says.
            with contextlib.suppress(OSError, ValueError):
                print(f"skatemount.{program}: {end}", file=sys.stderr, flush=True)
            sys.exit(end.status)


@contextlib.contextmanager
def shielded() -> Iterator[None]:
    """Let a signal wait until the ``with`` block is over, such as one that writes a checkpoint."""
    requests = _requests
    if requests is None:
        yield
        return
    requests.shields += 1
    try:
        yield
    finally:
        requests.shields -= 1
        if requests.waiting and not requests.shields:
            requests.waiting = False
            raise Ended(requests.received[0])
