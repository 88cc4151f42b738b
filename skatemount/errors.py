"""Errors that name the setting, its value and what would be right."""

from __future__ import annotations


class ConfigError(ValueError):
    """A setting has a value that cannot be used.

    The message is one line: it names the setting, the value it has, and the values that would do.
    """
