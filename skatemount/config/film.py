"""Settings of films."""

from __future__ import annotations

from dataclasses import dataclass, field

from skatemount.utils.bounds import check_bounds, number
from skatemount.utils.errors import ConfigError

CAMERAS = ("follow", "side", "top", "fixed")


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

    width: int = field(metadata=number(160, 3840, "pixels, an even number"))
    height: int = field(metadata=number(120, 2160, "pixels, an even number"))
    camera: str
    speed: float = field(metadata=number(0.05, 20, why="0.5 plays at half speed"))
    gif: bool

    def validate(self, where: str = "film") -> None:
        """Raise `ConfigError` for the first setting that cannot be used."""
        check_bounds(self, where)
        for name in ("width", "height"):
            if (pixels := getattr(self, name)) % 2:
                raise ConfigError(f"{where}.{name}={pixels} must be an even number of pixels")
        if self.camera not in CAMERAS:
            raise ConfigError(f"{where}.camera={self.camera} must be one of {', '.join(CAMERAS)}")
