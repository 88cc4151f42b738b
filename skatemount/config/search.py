"""Settings of a search, and the form in which its space is written."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from skatemount.utils.bounds import check_bounds, number
from skatemount.utils.errors import ConfigError, brief

SAMPLERS = ("tpe", "random")
PRUNERS = ("median", "none")
FORMS = "float(low,high), log(low,high), int(low,high), logint(low,high) or choice(a,b,...)"
"""Forms of a range."""

_CALL = re.compile(r"\s*(\w+)\s*\((.*)\)\s*", re.DOTALL)
_WHOLE = re.compile(r"[+-]?\d[\d_]*(\.0*)?([eE]\+?\d+)?")


@dataclass(frozen=True)
class Dimension:
    """A setting that is searched, and its values.

    Attributes:
        key: Dotted key of the setting, or the name of a group.
        written: The range as the user wrote it.
        kind: ``float``, ``int`` or ``choice``.
        low: Smallest value of a number.
        high: Largest value of a number.
        log: A value is as likely in each factor of ten as in any other.
        step: Distance between the values of a number; None for all of them.
        choices: Values of a choice, as on a command line.
    """

    key: str
    written: str
    kind: str
    low: float = 0
    high: float = 0
    log: bool = False
    step: float | None = None
    choices: tuple[str, ...] = ()

    @property
    def where(self) -> str:
        """The setting as the user wrote it, for messages."""
        return f"search.space.{self.key}={brief(self.written)}"


@dataclass
class SearchConfig:
    """Search of good settings by `python -m skatemount.search`.

    Attributes:
        trials: Trials of the whole search, in all processes together; with a larger number a search goes on.
        space: Range of each setting that is searched: ``float(low,high)``, ``log(low,high)`` for a float whose
            magnitude matters, ``int(low,high)``, ``logint(low,high)``, or ``choice(a,b,...)`` of values or of files of
            a group; ``float`` and ``int`` take a third number, the distance between two values.
        sampler: Choice of a trial's settings: ``tpe`` learns from the trials before, ``random`` does not.
        random_trials: Trials with random settings before ``tpe`` begins.
        seed: Seed of the sampler; the trainings have the setting ``seed``.
        pruner: Early end of trials: ``median`` ends one whose best success so far is below the median of the others
            at the same point of their training, ``none`` ends none.
        prune_startup: Trials that must have finished before any is pruned.
        prune_after: Share of a training before which it is not pruned.
        stale_after: Time without a sign of life after which another process takes over a trial, s.
    """

    trials: int = field(metadata=number(1, 1_000_000))
    space: dict[str, Any]
    sampler: str
    random_trials: int = field(metadata=number(0, 1_000_000))
    seed: int = field(metadata=number(0, 2**62))
    pruner: str
    prune_startup: int = field(metadata=number(1, 1_000_000))
    prune_after: float = field(metadata=number(0, 1))
    stale_after: float = field(metadata=number(5, 1e6, "s"))

    def validate(self, where: str = "search") -> None:
        """Raise `ConfigError` for the first setting that cannot be used."""
        check_bounds(self, where)
        for name, known in (("sampler", SAMPLERS), ("pruner", PRUNERS)):
            if (value := getattr(self, name)) not in known:
                raise ConfigError(f"{where}.{name}={value} must be {' or '.join(known)}")
        if self.space:
            # Without one, only a search is refused: the settings can be composed and printed.
            self.dimensions()

    def dimensions(self) -> list[Dimension]:
        """Return the settings that are searched, sorted by their keys.

        Raises:
            ConfigError: There is none, or a range cannot be read.
        """
        found: dict[str, Dimension] = {}
        for key, value in _leaves(self.space, ""):
            if key in found:
                raise ConfigError(f"search.space.{key}={brief(value)}: the range is given twice, nested and with dots")
            found[key] = _dimension(key, value)
        if not found:
            raise ConfigError(
                'search.space={} must have a range: search.space.<setting>="log(1e-4,1e-2)", or search=<file> with one'
            )
        return [found[key] for key in sorted(found)]


def _leaves(values: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    """Yield the ranges of a nested space, which may have dotted keys as well."""
    for name, value in values.items():
        key = f"{prefix}{name}"
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{key}.")
        else:
            yield key, value


def _dimension(key: str, value: Any) -> Dimension:
    """Return a range that a user wrote.

    Raises:
        ConfigError: It is none; the message says what is wrong.
    """
    where = f"search.space.{key}={'null' if value is None else brief(value)}"
    match = _CALL.fullmatch(value) if isinstance(value, str) else None
    if match is None:
        raise ConfigError(f"{where} must be {FORMS}")
    name, arguments = match[1], _split(match[2])
    if name == "choice":
        if len(arguments) < 2 or "" in arguments:
            raise ConfigError(f"{where} must have at least two values, such as choice(a,b)")
        if twice := [each for each in arguments if arguments.count(each) > 1]:
            raise ConfigError(f"{where}: {twice[0]} is there twice")
        return Dimension(key, value, "choice", choices=tuple(arguments))
    if name not in ("float", "log", "int", "logint"):
        raise ConfigError(f"{where}: there is no {name}; a range is {FORMS}")
    whole, log = name.endswith("int"), name.startswith("log")
    if not (len(arguments) == 2 or len(arguments) == 3 and not log):
        more = "" if log else f", or {name}(low,high,step)"
        raise ConfigError(f"{where} must have two numbers, {name}(low,high){more}")
    numbers = [_number(each, whole, where) for each in arguments]
    low, high = numbers[:2]
    step = numbers[2] if len(numbers) == 3 else None
    if not low < high:
        raise ConfigError(f"{where}: {arguments[0]} must be below {arguments[1]}")
    if log and low <= 0:
        raise ConfigError(f"{where}: {arguments[0]} must be above 0, because the scale is logarithmic")
    if step is not None and not 0 < step <= high - low:
        raise ConfigError(f"{where}: the step {arguments[2]} must be above 0 and at most {high - low:g}")
    return Dimension(key, value, "int" if whole else "float", low, high, log, step)


def _number(text: str, whole: bool, where: str) -> float:
    """Return a number of a range, an int if it is whole; `ConfigError` if it is none."""
    try:
        value = float(text.replace("_", ""))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ConfigError(f"{where}: {text or 'nothing'} must be a number")
    if not whole:
        return value
    if not _WHOLE.fullmatch(text) or len(text) > 30:
        raise ConfigError(f"{where}: {text} must be a whole number")
    return int(value)


def _split(text: str) -> list[str]:
    """Return the parts of a text that commas outside of brackets and quotes separate."""
    parts, depth, quote, start = [], 0, "", 0
    for i, letter in enumerate(text):
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "'\"":
            quote = letter
        elif letter in "([{":
            depth += 1
        elif letter in ")]}":
            depth -= 1
        elif letter == "," and not depth:
            parts.append(text[start:i].strip())
            start = i + 1
    return [*parts, text[start:].strip()] if text.strip() else []
