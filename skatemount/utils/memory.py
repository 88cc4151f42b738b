"""How the C library handles the memory of large arrays, and Python that of many objects."""

from __future__ import annotations

import contextlib
import ctypes
import gc
from collections.abc import Iterator

_TRIM_THRESHOLD, _MMAP_MAX = -1, -4
"""Parameters of glibc's ``mallopt``, from its ``malloc.h``."""


def disable_malloc_trim() -> None:
    """Let the C library keep the memory of freed arrays for the next ones, instead of giving it back to the system.

    Learning makes and drops arrays of some megabytes all the time. Memory that comes from the system anew is cleared
    page by page as it is first touched, which can take longer than what is computed in it. The process's memory does
    not shrink any more. Of other threads than the main one, large arrays still come from the system; elsewhere than in
    glibc, nothing happens.
    """
    with contextlib.suppress(AttributeError, OSError):
        mallopt = ctypes.CDLL(None).mallopt
        # Glibc maps large arrays by themselves and unmaps them when freed, and does so above 32 MiB whatever its
        # threshold is. Without such mappings all come from the heap, which is never trimmed.
        mallopt(_MMAP_MAX, 0)
        mallopt(_TRIM_THRESHOLD, -1)


@contextlib.contextmanager
def lasting_objects() -> Iterator[None]:
    """What is made in this block stays until the program ends, as imported modules do: no garbage is looked for in it.

    Importing torch and TorchRL makes so many objects that looking through them again and again takes an eighth of the
    time. Afterwards the garbage collector, if it was on, is on again and leaves them out.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        if enabled:
            gc.enable()
