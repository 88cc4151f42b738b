"""Settings of films."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from skatemount.utils.bounds import check_bounds, number
from skatemount.utils.errors import ConfigError, brief

CAMERAS = ("follow", "side", "top", "fixed")
BACKGROUNDS = ("floor", "plain")
FAILED = "failed"
"""Value of ``episodes`` that films failures."""

MAX_TOGETHER = 16
"""Most episodes in one film. Each needs a drawing context with a model of its own."""

MAX_EPISODE = 2**40


@dataclass
class FilmConfig:
    """Size, camera and speed of the film that `python -m skatemount.record` makes.

    Attributes:
        width: Pixels, an even number; of a film of several episodes, those of all pictures together.
        height: Pixels, an even number.
        camera: One of `CAMERAS`: ``follow``, ``side`` and ``top`` move with robot and board; ``fixed`` stands still and
            sees the whole episode.
        background: One of `BACKGROUNDS`: ``floor`` has tiles that show the motion, ``plain`` is one color with shadows.
        caption: Whether to write policy, suite, seed and episode at the top.
        speed: Seconds of the episode in a second of the film. Below 1, states between the control steps are shown, too.
        start: Time in the episode at which the film starts, s.
        end: Time in the episode at which the film ends, s; null for the end of the episode.
        gif: Whether to write a GIF as well.
        gif_width: Width of the GIF, pixels.
    """

    width: int = field(metadata=number(160, 3840, "pixels, an even number"))
    height: int = field(metadata=number(120, 2160, "pixels, an even number"))
    camera: str
    background: str
    caption: bool
    speed: float = field(metadata=number(0.05, 20, why="0.5 plays at half speed"))
    start: float = field(metadata=number(0, 3600, "s"))
    end: float | None = field(metadata=number(0, 3600, "s", above=True))
    gif: bool
    gif_width: int = field(metadata=number(80, 1920, "pixels"))

    def validate(self, where: str = "film") -> None:
        """Raise `ConfigError` for the first setting that cannot be used."""
        check_bounds(self, where)
        for name in ("width", "height"):
            if (pixels := getattr(self, name)) % 2:
                raise ConfigError(f"{where}.{name}={pixels} must be an even number of pixels")
        for name, known in (("camera", CAMERAS), ("background", BACKGROUNDS)):
            if (value := getattr(self, name)) not in known:
                raise ConfigError(f"{where}.{name}={value} must be one of {', '.join(known)}")
        if self.end is not None and self.end <= self.start:
            raise ConfigError(f"{where}.end={self.end} must be above {where}.start={self.start}")


def check_episodes(episodes: Any, episode: int | None) -> None:
    """Check the setting ``episodes``.

    Args:
        episodes: Its value.
        episode: That of ``episode``.

    Raises:
        ConfigError: It is neither null, a number, a list of numbers, nor `FAILED`; or ``episode`` is given, too.
    """
    if episodes is None:
        return
    where = f"episodes={brief(episodes)}"
    if episode is not None:
        raise ConfigError(f"{where} with episode={episode}: leave out one of the two")
    if episodes == FAILED:
        return
    several = list(episodes) if isinstance(episodes, list | tuple) else [episodes]
    if any(isinstance(each, bool) or not isinstance(each, int) for each in several):
        raise ConfigError(f"{where} must be a number such as 4, a list of numbers such as [0,3,7], or {FAILED}")
    if not isinstance(episodes, list | tuple):
        if not 1 <= episodes <= MAX_TOGETHER:
            raise ConfigError(f"{where} must be from 1 to {MAX_TOGETHER}: so many episodes share a film")
    elif not 1 <= len(several) <= MAX_TOGETHER:
        raise ConfigError(f"{where} has {len(several)} episodes; a film shows 1 to {MAX_TOGETHER}")
    elif not all(0 <= each <= MAX_EPISODE for each in several):
        raise ConfigError(f"{where} must be numbers of episodes, each from 0 to {MAX_EPISODE}")
    elif len(set(several)) < len(several):
        raise ConfigError(f"{where} names an episode twice")


def numbers_of(episodes: Any) -> list[int] | None:
    """Return the numbers that ``episodes`` asks for; None if it names none."""
    if episodes is None or episodes == FAILED:
        return None
    return list(range(episodes)) if isinstance(episodes, int) else list(episodes)
