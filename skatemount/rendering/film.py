"""Films of one or several episodes, and pictures of their moments."""

from __future__ import annotations

import contextlib
import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from skatemount.config.files import load_file
from skatemount.config.film import FilmConfig
from skatemount.envs.config.physics import PhysicsConfig
from skatemount.rendering import overlay
from skatemount.rendering.camera import LABEL_ROOM, MARGIN, VIEWS, camera_path
from skatemount.rendering.moments import choose_moments
from skatemount.rendering.playback import Episode
from skatemount.rendering.renderer import EpisodeRenderer
from skatemount.rendering.video import GifWriter, mp4_writer
from skatemount.utils.errors import ConfigError
from skatemount.utils.formatting import format_duration

MAX_RATE = 60.0
"""Pictures a second; of a faster film only every so many frames are shown."""

SMOOTH = 24.0
"""Pictures a second that a slow motion has, if there are enough physics steps."""

HOLD = 1.2
"""Seconds that the last picture, which tells the outcome, is shown."""

GAP = 8
"""Pixels between the pictures of a sheet."""

ASPECT = 4 / 3
"""Width of a picture in a sheet divided by its height."""

MOMENT_WIDTH, ROW_WIDTH = 640, 288
"""Width of a picture in the sheet of one episode, and of several, whose moments are a row each."""

TOLD_AFTER = 6
"""Pictures after which the time for all of them is estimated; the first one takes longer than the others."""


def parts_of(film: FilmConfig, physics: PhysicsConfig) -> int:
    """Return the number of frames of a control step that a film needs to be smooth.

    Args:
        film: The film.
        physics: Control rate of the policy.
    """
    wanted = min(SMOOTH, 1 / physics.control_step)
    divisors = [n for n in range(1, physics.substeps + 1) if physics.substeps % n == 0]
    enough = [n for n in divisors if film.speed * n / physics.control_step >= wanted - 1e-6]
    return enough[0] if enough else physics.substeps


def default_film(**changes: Any) -> FilmConfig:
    """Return the settings of a film in ``conf/film/default.yaml``, with changes."""
    return FilmConfig(**load_file("film", "default") | changes)


def timeline(
    seconds: float, time_step: float, film: FilmConfig, max_rate: float = MAX_RATE
) -> tuple[list[float], float]:
    """Return the times of the pictures in the episode, and the pictures a second.

    Args:
        seconds: Length of the longest episode.
        time_step: Seconds between two frames.
        film: The film.
        max_rate: Most pictures a second.

    Raises:
        ConfigError: The film starts after the end of the episode.
    """
    rate = film.speed / time_step
    every = max(1, math.ceil(rate / max_rate - 1e-6))
    first, last = round(film.start / time_step), round(seconds / time_step)
    if first and first >= last:
        raise ConfigError(f"film.start={film.start:g} must be below {seconds:.2f} s, where the film ends")
    if film.end is not None:
        last = min(last, round(film.end / time_step))
    return [i * time_step for i in (*range(first, last, every), last)], rate / every


@dataclass(frozen=True)
class Grid:
    """Places of the pictures of several episodes in a film.

    Attributes:
        columns: Number of columns.
        size: Width and height of one picture, pixels.
        title: Height of the bar above them, pixels.
    """

    columns: int
    size: tuple[int, int]
    title: int

    @classmethod
    def of(cls, count: int, width: int, height: int, title: bool) -> Grid:
        """Return the grid with the largest pictures.

        Args:
            count: Number of pictures.
            width: Width of the film, pixels.
            height: Its height.
            title: Whether there is a bar above.
        """
        bar = round(0.055 * height) if title else 0
        grids = []
        for columns in range(1, count + 1):
            rows = math.ceil(count / columns)
            size = (width - GAP * (columns - 1)) // columns, (height - bar - GAP * (rows - 1)) // rows
            grids.append((min(size[0], size[1] * ASPECT), columns, size))
        _, columns, size = max(grids)
        return cls(columns, size, bar)

    def place(self, i: int) -> tuple[int, int]:
        """Return the upper left corner of a picture."""
        row, column = divmod(i, self.columns)
        return column * (self.size[0] + GAP), self.title + row * (self.size[1] + GAP)


class Shot:
    """An episode in front of a camera.

    Args:
        episode: The episode.
        film: Camera and background.
        size: Width and height of its pictures, pixels.
        caption: Text at the top of each picture; empty for none.
    """

    def __init__(self, episode: Episode, film: FilmConfig, size: tuple[int, int], caption: str = ""):
        self.episode = episode
        self._caption = caption
        self._painter = EpisodeRenderer(episode.model, episode.feet, *size, plain=film.background == "plain")
        robot, board, step = episode.robot, episode.board, episode.control_step
        view, aspect = VIEWS[film.camera], size[0] / size[1]
        # The margin at the edges is part of what the text takes.
        bottom, top = (max(each - (1 - MARGIN), 0.0) for each in overlay.rooms(size, bool(caption)))
        rooms = max(bottom, LABEL_ROOM), top
        self._path = camera_path(view, robot, board, episode.heading, aspect, step, rooms)

    def index(self, seconds: float) -> int:
        """Return the frame at a time; the last one if the episode has ended by then."""
        return min(round(seconds / self.episode.time_step), len(self.episode.frames) - 1)

    def draw(self, i: int, caption: str | None = None) -> Image.Image:
        """Return the picture of a frame with its label.

        Args:
            i: The frame.
            caption: Text at the top in place of the shot's.
        """
        frame = self.episode.frames[i]
        picture = self._painter.draw(frame, self._path.at(i / self.episode.parts))
        return overlay.draw_caption(overlay.draw_overlay(picture, frame), caption or self._caption)

    def close(self) -> None:
        """Free the drawing context."""
        self._painter.close()


def caption_of(episode: Episode) -> str:
    """Return what tells an episode from others of its evaluation."""
    return ", ".join(filter(None, (f"episode {episode.number}", episode.variant, episode.deck)))


def moments_sheet(episodes: Sequence[Episode], film: FilmConfig, title: str, width: int | None = None) -> Image.Image:
    """Return a picture of the moments of episodes: of one in two rows, of several in a row for each.

    Args:
        episodes: The episodes.
        film: Camera and background; ``caption`` decides on the lines of text above the pictures.
        title: Text above all; of one episode, what became of it follows.
        width: Width of one picture, pixels; `MOMENT_WIDTH` or `ROW_WIDTH` if None.

    Raises:
        ConfigError: There is no OpenGL.
    """
    alone = len(episodes) == 1
    width = width or (MOMENT_WIDTH if alone else ROW_WIDTH)
    height, bar = round(width / ASPECT), round(36 if alone else 28)
    parts: list[Image.Image] = []
    for episode in episodes:
        said = f"{caption_of(episode)}: {episode.summary}"
        strip = _strip(episode, film, (width, height), 3 if alone else 6)
        if film.caption:
            text = f"{title}, {said}" if alone else said
            ink = overlay.DECK if episode.frames[-1].succeeded else overlay.FAILED
            parts.append(overlay.draw_title(text, strip.width, bar, overlay.TEXT if alone else ink))
        parts.append(strip)
    if film.caption and not alone:
        parts.insert(0, overlay.draw_title(title, parts[0].width, round(1.3 * bar)))
    return _stacked(parts)


def _strip(episode: Episode, film: FilmConfig, size: tuple[int, int], columns: int) -> Image.Image:
    """Return the moments of an episode, row by row."""
    with contextlib.closing(Shot(episode, film, size, " ")) as shot:
        pictures = []
        # Contacts are measured once a control step.
        for letter, moment in zip("abcdef", choose_moments(episode.frames[:: episode.parts]), strict=False):
            pictures.append(shot.draw(moment.index * episode.parts, f"({letter}) {moment.name}".rstrip()))
    rows = math.ceil(6 / columns) if len(pictures) > columns else 1
    strip = Image.new("RGB", (columns * (size[0] + GAP) - GAP, rows * (size[1] + GAP) - GAP), "white")
    for i, picture in enumerate(pictures):
        strip.paste(picture, (i % columns * (size[0] + GAP), i // columns * (size[1] + GAP)))
    return strip


def _stacked(parts: Sequence[Image.Image]) -> Image.Image:
    """Return pictures of one width, one below the other."""
    sheet = Image.new("RGB", (parts[0].width, sum(part.height for part in parts)), "white")
    top = 0
    for part in parts:
        sheet.paste(part, (0, top))
        top += part.height
    return sheet


def write_film(
    episodes: Sequence[Episode],
    film: FilmConfig,
    title: str,
    mp4: Path,
    gif: Path | None = None,
    sample: Image.Image | None = None,
    say: Callable[[str], None] = lambda text: None,
    max_rate: float = MAX_RATE,
) -> Image.Image:
    """Draw a film picture by picture, and write each at once.

    Args:
        episodes: Its episodes; several are shown side by side, and one that has ended keeps its last picture.
        film: Its settings.
        title: Policy, suite and seed.
        mp4: The file.
        gif: File of the GIF; None for none.
        sample: Picture with the colors of the film, for a GIF.
        say: Called with the time that the film will take, and has taken.
        max_rate: Most pictures a second.

    Returns:
        The last picture.

    Raises:
        ConfigError: There is no OpenGL or no ffmpeg, or the film starts after the end of the episode.
    """
    from rich.progress import track

    longest = max((len(each.frames) - 1) * each.time_step for each in episodes)
    times, rate = timeline(longest, min(each.time_step for each in episodes), film, max_rate)
    began = time.perf_counter()
    with contextlib.ExitStack() as stack:
        pictures = _Pictures(episodes, film, title, stack)
        writer = stack.enter_context(mp4_writer(mp4, rate, (film.width, film.height)))
        small = None
        if gif is not None:
            assert sample is not None
            size = film.gif_width, round(film.height * film.gif_width / film.width)
            small = stack.enter_context(contextlib.closing(GifWriter(gif, rate, size, sample, HOLD)))
        for i, seconds in enumerate(track(times, "drawing", transient=True, disable=not sys.stdout.isatty())):
            picture = pictures.at(seconds)
            last = i == len(times) - 1
            for _ in range(max(1, round(HOLD * rate)) if last else 1):
                writer.send(np.asarray(picture).tobytes())
            if small is not None:
                (small.finish if last else small.add)(picture)
            if i == 0:
                first = time.perf_counter()
            elif i == TOLD_AFTER:
                needed = first - began + (time.perf_counter() - first) / i * (len(times) - 1)
                what = f"{len(times)} pictures of {film.width} x {film.height}"
                say(f"drawing {what}, about {format_duration(needed)} min")
    say(f"drawn in {format_duration(time.perf_counter() - began)} min")
    return picture


class _Pictures:
    """The pictures of a film by their time.

    Args:
        episodes: The episodes.
        film: The settings.
        title: Policy, suite and seed.
        stack: Frees the drawing contexts at its end.
    """

    def __init__(self, episodes: Sequence[Episode], film: FilmConfig, title: str, stack: contextlib.ExitStack):
        alone = len(episodes) == 1
        self._grid = Grid.of(len(episodes), film.width, film.height, film.caption and not alone)
        self._sheet = Image.new("RGB", (film.width, film.height), overlay.PANEL)
        if self._grid.title:
            self._sheet.paste(overlay.draw_title(title, film.width, self._grid.title), (0, 0))
        self._shots: list[Shot] = []
        for episode in episodes:
            said = f"{title}, {caption_of(episode)}" if alone else caption_of(episode)
            shot = Shot(episode, film, self._grid.size, said if film.caption else "")
            stack.callback(shot.close)
            self._shots.append(shot)
        self._drawn: list[int | None] = [None] * len(episodes)

    def at(self, seconds: float) -> Image.Image:
        """Return the picture at a time of the episodes; a later call changes it."""
        for i, shot in enumerate(self._shots):
            index = shot.index(seconds)
            if index != self._drawn[i]:
                self._sheet.paste(shot.draw(index), self._grid.place(i))
                self._drawn[i] = index
        return self._sheet


def save_sheet(sheet: Image.Image, path: Path) -> None:
    """Write a sheet as a PNG of 256 colors, which is a third as large."""
    sheet.quantize(256, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.FLOYDSTEINBERG).save(
        path, format="png", optimize=True
    )
