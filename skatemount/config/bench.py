"""Settings of the speed measurement."""

from __future__ import annotations

from dataclasses import dataclass

from skatemount.utils.errors import ConfigError


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

    worlds: list[int]
    threads: list[int]
    rounds: int
    seconds: float
    profile: bool
    start: bool

    def validate(self, where: str = "bench") -> None:
        """Raise `ConfigError` for values that cannot be measured with."""
        for name in ("worlds", "threads"):
            if any(each < 1 for each in getattr(self, name)):
                raise ConfigError(f"{where}.{name}={getattr(self, name)} must be numbers of at least 1")
        if self.rounds < 1:
            raise ConfigError(f"{where}.rounds={self.rounds} must be at least 1")
        if not 0 < self.seconds <= 3600:
            raise ConfigError(f"{where}.seconds={self.seconds} must be above 0, and at most 3600")
