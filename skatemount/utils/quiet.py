"""Warnings of libraries that a user can do nothing about."""

from __future__ import annotations

import warnings


def ignore_torchrl_warnings() -> None:
    """Ignore the deprecation warnings that TorchRL raises about its own weight updaters."""
    warnings.filterwarnings("ignore", message="Creating .*WeightUpdater", category=DeprecationWarning)
