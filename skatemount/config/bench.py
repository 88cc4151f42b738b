"""Settings of the speed measurement."""

from __future__ import annotations

from dataclasses import dataclass

from skatemount.utils.errors import ConfigError


@dataclass
class BenchConfig:
    """What `python -m skatemount.bench` measures besides the settings at hand.

    Attributes:
        worlds: Numbers of worlds to measure, one after the other; none if empty.
        threads: Numbers of threads, of physics and of torch; none if empty.
        rounds: How often every figure is taken, in turns; all of them count.
        seconds: For each figure in a round, at least.
        profile: Whether to measure which part of the code the time goes to.
        start: Whether to measure how long the training command takes until its first iteration is done.
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
