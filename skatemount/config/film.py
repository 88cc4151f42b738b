"""Settings of films."""

from __future__ import annotations

from dataclasses import dataclass

from skatemount.utils.errors import ConfigError

CAMERAS = ("follow", "side", "top", "fixed")

SIZES = {"width": (160, 3840), "height": (120, 2160)}
"""Smallest and largest value of each, pixels."""


@dataclass
class FilmConfig:
    """Size, camera and speed of the film that `python -m skatemount.record` makes.

    Attributes:
        width: Pixels, an even number.
        height: Pixels, an even number.
        camera: One of `CAMERAS`: ``follow``, ``side`` and ``top`` move with robot and board; ``fixed`` stands still and
            sees the whole episode.
        speed: Seconds of the episode in a second of the film.
        gif: Whether to write a GIF as well.
    """

    width: int
    height: int
    camera: str
    speed: float
    gif: bool

    def validate(self, where: str = "film") -> None:
        """Raise `ConfigError` for the first setting that cannot be used."""
        for name, (low, high) in SIZES.items():
            pixels = getattr(self, name)
            if not low <= pixels <= high or pixels % 2:
                raise ConfigError(f"{where}.{name}={pixels} must be an even number of pixels from {low} to {high}")
        if self.camera not in CAMERAS:
            raise ConfigError(f"{where}.camera={self.camera} must be one of {', '.join(CAMERAS)}")
        if not 0.05 <= self.speed <= 20:
            raise ConfigError(f"{where}.speed={self.speed} must be from 0.05 to 20; 0.5 plays at half speed")
