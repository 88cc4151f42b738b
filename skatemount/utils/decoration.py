"""`Decoration`: work that may fail without ending a training or an evaluation."""

from __future__ import annotations

import sys
from types import TracebackType


class Decoration:
    """A ``with`` block whose error becomes a warning, such as one that draws a picture.

    It can be used many times; only the first error is shown. Requests to end the program pass.

    Args:
        what: The work, as the subject of the warning.

    Attributes:
        failed: Number of blocks that failed.
    """

    def __init__(self, what: str) -> None:
        self.what = what
        self.failed = 0

    def __enter__(self) -> Decoration:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> bool:
        """Turn an error into a warning, and return whether there was one."""
        if not isinstance(error, Exception):
            return False
        self.warn(error)
        return True

    def warn(self, error: Exception) -> None:
        """Count an error, and show it if it is the first one."""
        self.failed += 1
        if self.failed == 1:
            text = " ".join(str(error).split())
            said = f"{type(error).__name__}: {text}" if text else type(error).__name__
            print(f"warning: {self.what} failed, the rest goes on ({said})", file=sys.stderr, flush=True)
