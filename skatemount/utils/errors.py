"""Errors in one line: of settings, with the values that are allowed, and of files, with what to do."""

from __future__ import annotations

import errno
import math
import re
import sysconfig
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any


class ConfigError(ValueError):
    """An error for a setting that has an unusable value.

    The message is one line. It names the setting, its value, and the values that are allowed.
    """


def place_of(error: BaseException) -> str:
    """Return the line of a user's code that an error came from, such as `` (mine.py, line 3)``; "" if unknown."""
    if isinstance(error, SyntaxError) and error.filename is not None:
        return f" ({error.filename}, line {error.lineno})"
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if not frame.filename.startswith((*_NOT_OF_THE_USER, "<"))] or frames
    return f" ({own[-1].filename}, line {own[-1].lineno})" if own else ""


class StorageError(OSError):
    """An error of the file system that ended a program.

    The message is one line. It names the file, the reason, what to do, and what is left.

    Args:
        error: The error.
        left: What the program leaves behind and how to go on.
    """

    def __init__(self, error: OSError, left: str) -> None:
        said = error.strerror or " ".join(str(error).split()) or type(error).__name__
        super().__init__(error.errno, f"{said}{advice(error)}; {left}", error.filename)

    def __str__(self) -> str:
        return f"{self.filename}: {self.strerror}" if self.filename is not None else str(self.strerror)


_ADVICE = {
    errno.ENOSPC: "free some space there",
    errno.EDQUOT: "free some space there, or raise your quota",
    errno.EFBIG: "raise the limit of a file's size, which ulimit -f shows",
    errno.EROFS: "make it writable",
    errno.EACCES: "change its permissions",
    errno.EPERM: "change its permissions",
}


def advice(error: OSError) -> str:
    """Return what a user can do about a file that cannot be written, after a semicolon; "" if there is no advice."""
    known = _ADVICE.get(error.errno or 0)
    return "" if known is None else f"; {known}"


def brief(value: Any) -> str:
    """Return a value as text for a message; the middle of a long one is left out."""
    text = "null" if value is None else str(value)
    return text if len(text) <= 200 else f"{text[:120]} … {text[-40:]}"


_NOT_OF_THE_USER = (str(Path(__file__).parents[1]), *map(sysconfig.get_path, ("stdlib", "purelib", "platlib")))
"""Folders of code that a user did not write."""


def reason(error: BaseException) -> str:
    """Return in one line what went wrong in code of a user's: type, message and place of an error."""
    return f"{type(error).__name__}: {brief(' '.join(str(error).split()))}{place_of(error)}"


_NOT_IN_A_NAME = re.compile(r"[/\\:\x00-\x1f\x7f]")


def check_name(where: str, name: str) -> None:
    """Check that a name can be part of a file's name, which does not lead to another folder.

    Args:
        where: Name of the setting.
        name: The name; "" for none.

    Raises:
        ConfigError: It has a separator of paths or a control character, begins with a dot, or is too long.
    """
    if _NOT_IN_A_NAME.search(name) or name.startswith(".") or len(name) > 100:
        raise ConfigError(
            f"{where}={name[:120]!r} must be a name of up to 100 characters, without / \\ : or a leading dot"
        )


def check_range(where: str, value: Sequence[float]) -> None:
    """Check that a setting is a range to sample from.

    Args:
        where: Name of the setting.
        value: ``[low, high]``.

    Raises:
        ConfigError: It does not have two finite numbers, the lower one first.
    """
    if not (len(value) == 2 and value[0] <= value[1] and all(math.isfinite(bound) for bound in value)):
        raise ConfigError(f"{where}={value} must be a range [low, high] with low <= high")
