"""Bounds of settings: declared with the fields of a dataclass, and checked by one function.

A field declares what its numbers may be in its metadata::

    kp: float = field(metadata=number(0, 10_000, "N m/rad", above=True))
    x: list[float] = field(metadata=interval(-100, 100, "m"))

The bounds refuse what cannot be meant or cannot be computed. They are far wider than what is sensible to try.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

from skatemount.utils.errors import ConfigError, brief, check_range

UNREACHED = 10**11
"""Upper bounds from here on only keep a number in its type."""

KEY = "bounds"
"""Name of the bounds in a field's metadata."""


@dataclass(frozen=True)
class Bounds:
    """Values that a number may have.

    Attributes:
        low: Smallest value.
        high: Largest value.
        unit: Unit, for messages.
        above: True if the value must be above ``low``.
        below: True if the value must be below ``high``.
        zero: Meaning of 0, if 0 has a meaning of its own.
        why: Reason, for messages.
        shape: ``number``; ``interval`` for a list ``[low, high]`` with both ends within the bounds; ``each`` for a
            list whose entries are within them.
    """

    low: float
    high: float
    unit: str = ""
    above: bool = False
    below: bool = False
    zero: str = ""
    why: str = ""
    shape: str = "number"

    def allow(self, value: Any) -> bool:
        """Return whether a number is within the bounds; nan and other types than numbers are not."""
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            return False
        if self.zero and value == 0:
            return True
        enough = value > self.low if self.above else value >= self.low
        return enough and (value < self.high if self.below else value <= self.high)

    def words(self, value: Any = None) -> str:
        """Return the values as words for a message, such as ``from 1 to 1000``.

        Args:
            value: A value that is out of bounds. A bound that nobody reaches is named only to who has passed it.
        """
        low, high = _shown(self.low), _shown(self.high)
        if self.high >= UNREACHED and not self.above and not self.below and not self.zero:
            passed = isinstance(value, int | float) and value > self.high
            return f"at most {self.high} {self.unit}".rstrip() if passed else f"{low} {self.unit}".rstrip() + " or more"
        if self.zero:
            text = f"0 ({self.zero}) or from {low} to {high}" if self.low != 0 else f"0 ({self.zero}) to {high}"
        elif self.above or self.below:
            text = f"{'above' if self.above else 'at least'} {low} and {'below' if self.below else 'at most'} {high}"
        else:
            text = f"from {low} to {high}"
        return f"{text} {self.unit}".rstrip()

    def check(self, where: str, value: Any) -> None:
        """Raise `ConfigError` unless a setting's value is within the bounds.

        Args:
            where: Name of the setting.
            value: Its value, a list if `shape` is not ``number``.
        """
        whose = {"number": "", "interval": "[low, high], both ", "each": "a list of numbers, each "}[self.shape]
        refused = ConfigError(
            f"{where}={brief(value)} must be {whose}{self.words(value)}{self.why and f'; {self.why}'}"
        )
        parts = [value] if self.shape == "number" else value
        if not isinstance(parts, list | tuple):
            raise refused
        if self.shape == "interval" and all(isinstance(part, int | float) for part in parts):
            check_range(where, parts)
        if not all(map(self.allow, parts)):
            raise refused


def number(
    low: float, high: float, unit: str = "", *, above: bool = False, below: bool = False, zero: str = "", why: str = ""
) -> dict[str, Bounds]:
    """Return the metadata of a field that holds a number or null; see `Bounds`."""
    return {KEY: Bounds(low, high, unit, above, below, zero, why)}


def interval(low: float, high: float, unit: str = "", *, above: bool = False, why: str = "") -> dict[str, Bounds]:
    """Return the metadata of a field that holds a range ``[low, high]`` or null; see `Bounds`."""
    return {KEY: Bounds(low, high, unit, above, why=why, shape="interval")}


def each(low: float, high: float, unit: str = "", *, above: bool = False) -> dict[str, Bounds]:
    """Return the metadata of a field that holds a list of numbers; see `Bounds`."""
    return {KEY: Bounds(low, high, unit, above, shape="each")}


def bounds_of(kind: type) -> dict[str, Bounds]:
    """Return the bounds of a dataclass's fields by name."""
    return {item.name: item.metadata[KEY] for item in dataclasses.fields(kind) if KEY in item.metadata}


def check_bounds(settings: Any, where: str) -> None:
    """Check every field of a dataclass that declares bounds; null is not checked.

    Args:
        settings: The dataclass.
        where: Name of the group, for messages; "" at the top.

    Raises:
        ConfigError: A value is out of bounds.
    """
    for name, bounds in bounds_of(type(settings)).items():
        value = getattr(settings, name)
        if value is not None or not _may_be_null(type(settings), name):
            bounds.check(f"{where}.{name}" if where else name, value)


def _may_be_null(kind: type, name: str) -> bool:
    # Annotations are text in modules that import them from __future__.
    return any(item.name == name and "None" in str(item.type) for item in dataclasses.fields(kind))


def _shown(value: float) -> str:
    """Return a bound as a user would write it."""
    return str(value) if isinstance(value, int) and abs(value) < 10**7 else f"{value:g}"
