"""Settings of the speed measurement."""

from __future__ import annotations

from dataclasses import dataclass, field

from skatemount.utils.bounds import check_bounds, each, number


@dataclass
class BenchConfig:
    """Measurements of `python -m skatemount.bench`.

    Attributes:
        worlds: Numbers of worlds to measure, one after the other.
        threads: Numbers of threads to measure, of physics and of torch alike.
        rounds: Times that each figure is measured, in turns; all of them count.
        seconds: Least duration of a measurement, s.
        profile: Measure the share of time of each part of the code.
        start: Measure the time from the training command to the end of its first iteration.
    """

    worlds: list[int] = field(metadata=each(1, 1_000_000))
    threads: list[int] = field(metadata=each(1, 1024))
    rounds: int = field(metadata=number(1, 10_000))
    seconds: float = field(metadata=number(0, 3600, "s", above=True))
    profile: bool
    start: bool

    def validate(self, where: str = "bench") -> None:
        """Raise `ConfigError` for values that cannot be measured with."""
        check_bounds(self, where)
