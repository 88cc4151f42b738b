"""Cores that a process may use."""

from __future__ import annotations

import os

from skatemount.utils.errors import ConfigError
from skatemount.utils.ranks import launch

CORES = "SKATEMOUNT_CORES"
"""Environment variable with the most cores that a process may use, such as a job of a multirun."""


def available_cores() -> int:
    """Return the number of cores that this process may use.

    Those are the cores that it may run on, at most as many as the variable `CORES` says, or its share of them if
    ``torchrun`` has started several ranks here.

    Raises:
        ConfigError: The variable is no number of cores.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if limit := os.environ.get(CORES):
        if not limit.isdecimal() or int(limit) < 1:
            raise ConfigError(f"{CORES}={limit} in the environment must be a whole number of at least 1")
        cores = min(cores, int(limit))
    return max(1, cores // max(1, launch().local_size or 1))
