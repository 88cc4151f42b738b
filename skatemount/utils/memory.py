"""Settings of the C library's memory allocator."""

from __future__ import annotations

import contextlib
import ctypes

_TRIM_THRESHOLD, _MMAP_MAX = -1, -4
"""Parameters of glibc's ``mallopt``, from its ``malloc.h``."""


def disable_malloc_trim() -> None:
    """Keep the memory of freed arrays in the process for the next ones.

    A PPO update allocates and frees arrays of some megabytes all the time. The system clears memory that it hands out,
    page by page at the first touch, which can take longer than the computation in it. After this call the process never
    returns memory to the system. It affects allocations of the main thread only, and does nothing without glibc.
    """
    with contextlib.suppress(AttributeError, OSError):
        mallopt = ctypes.CDLL(None).mallopt
        # Glibc maps large arrays one by one and unmaps them when they are freed; above 32 MiB it does so whatever its
        # threshold is. Without such mappings, all arrays come from the heap, which is never trimmed.
        mallopt(_MMAP_MAX, 0)
        mallopt(_TRIM_THRESHOLD, -1)
