"""Labels in pictures, and the filmstrip made of six of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from PIL import Image, ImageDraw, ImageFont

DECK, GROUND, AIR, FAILED = (46, 184, 114), (226, 230, 236), (110, 118, 130), (235, 104, 92)
PANEL, TEXT = (24, 29, 37), (255, 255, 255)


@dataclass
class Frame:
    """One moment of an episode: a pose and the facts of its label.

    Attributes:
        time: Seconds since the start of the episode.
        legs: Short names of the legs.
        on_deck: The feet that success counts as on the deck.
        touching: The feet that touch the deck or anything else.
        state: The task's word for the state of the robot, such as ``mounted``; empty if it is not in it.
        qpos: ``[nq]`` generalized positions.
        mocap_pos: ``[nmocap, 3]`` m.
        outcome: The end of the episode in words, in its last frame only.
        succeeded: Whether that end is a success.
    """

    time: float
    legs: Sequence[str]
    on_deck: Sequence[bool]
    touching: Sequence[bool]
    state: str
    qpos: np.ndarray
    mocap_pos: np.ndarray
    outcome: str = ""
    succeeded: bool = False

    @property
    def word(self) -> str:
        """The state of the robot in a word: ``start``, the task's word or nothing."""
        return "start" if self.time == 0 else self.state


def draw_overlay(picture: Image.Image, frame: Frame) -> Image.Image:
    """Write the time, the contacts of the feet, and in the last frame the outcome into a picture.

    A foot on the deck is green, one on anything else white, and one in the air gray. At the start nothing is known of
    the contacts, as physics has made no step yet: all feet have a white outline.

    Args:
        picture: The picture; stays unchanged. The label is as large as its height asks for.
        frame: The moment that it shows.

    Returns:
        A picture of the same size.
    """
    result = picture.convert("RGBA")
    size = max(5, min(round(picture.height * 0.038), picture.width // 26))
    margin = round(size * 0.7)
    panel = _contacts(frame, size)
    bottom = picture.height - margin - panel.height
    result.alpha_composite(panel, (margin, bottom))
    if frame.outcome:
        left, room = 2 * margin + panel.width, picture.width - panel.width - 3 * margin
        if _font(size).getlength(frame.outcome) + 2 * size > 1.5 * room:
            left, room = margin, picture.width - 2 * margin
            bottom -= panel.height + margin
        result.alpha_composite(_outcome(frame, size, panel.height, room), (left, bottom))
    return result.convert("RGB")


@lru_cache(maxsize=64)
def _panel(key: tuple[str, tuple[str, ...], tuple[str, ...], str], size: int) -> Image.Image:
    time, legs, states, word = key
    font, bold = _font(size), _font(round(size * 0.88))
    pad, gap = round(size * 0.5), round(size * 0.38)
    pill_w, row_h = round(size * 1.95), round(size * 1.5)
    time_w = round(font.getlength("00.00 s")) + 2 * gap
    word_w = round(bold.getlength(word)) + 2 * pad if word else 0
    width, height = (
        pad * 2 + time_w + len(legs) * pill_w + (len(legs) - 1) * gap + (gap + word_w if word else 0),
        row_h + 2 * pad,
    )
    # Drawn twice as large and shrunk: Pillow does not smooth the edges of shapes.
    panel = Image.new("RGBA", (width * 2, height * 2), (0, 0, 0, 0))
    draw = ImageDraw.Draw(panel)
    draw.rounded_rectangle((0, 0, panel.width - 1, panel.height - 1), radius=pad * 2, fill=(*PANEL, 205))

    def pill(x: int, w: int, text: str, ink: tuple[int, ...], **shape: object) -> None:
        box = (x * 2, pad * 2, (x + w) * 2, (pad + row_h) * 2)
        if shape:
            draw.rounded_rectangle(box, radius=row_h * 0.6, **shape)  # type: ignore[arg-type]
        draw.text((box[0] + w, height), text, font=_font(round(size * 0.88) * 2), fill=ink, anchor="mm")

    draw.text((pad * 2 + 4, height), time, font=_font(size * 2), fill=TEXT, anchor="lm")
    x = pad + time_w
    for leg, state in zip(legs, states, strict=True):
        if state == "start":
            pill(x, pill_w, leg, GROUND, outline=(*AIR, 255), width=max(1, size // 8))
        elif state == "deck":
            pill(x, pill_w, leg, TEXT, fill=DECK)
        elif state == "ground":
            pill(x, pill_w, leg, PANEL, fill=GROUND)
        else:
            pill(x, pill_w, leg, (*AIR, 255))
        x += pill_w + gap
    if word:
        pill(x, word_w, word, GROUND if word == "start" else DECK)
    return panel.resize((width, height), Image.Resampling.LANCZOS)


def _contacts(frame: Frame, size: int) -> Image.Image:
    """Return the panel at the bottom: time, feet and a word."""
    states = tuple(
        "start" if frame.time == 0 else "deck" if deck else "ground" if touch else "air"
        for deck, touch in zip(frame.on_deck, frame.touching, strict=True)
    )
    return _panel((f"{frame.time:.2f} s", tuple(frame.legs), states, frame.word), size)


def _outcome(frame: Frame, size: int, height: int, room: int) -> Image.Image:
    """Return the panel beside or above it: the end of the episode, in letters so small that ``room`` pixels do."""
    while size > 5 and _font(size).getlength(frame.outcome) + 2 * size > room:
        size -= 1
    width = min(room, round(_font(size).getlength(frame.outcome)) + 2 * size)
    panel = Image.new("RGBA", (width * 2, height * 2), (0, 0, 0, 0))
    draw = ImageDraw.Draw(panel)
    draw.rounded_rectangle((0, 0, panel.width - 1, panel.height - 1), radius=height // 2, fill=(*PANEL, 205))
    ink = DECK if frame.succeeded else FAILED
    draw.text((width, height), frame.outcome, font=_font(size * 2), fill=ink, anchor="mm")
    return panel.resize((width, height), Image.Resampling.LANCZOS)


def choose_frames(frames: Sequence[Frame], count: int = 6) -> list[int]:
    """Choose the frames of a filmstrip.

    These are the first and the last frame, and between them frames at equal distances: from the start to half a second
    after the robot has come to the task's state for good, or to the end if it has not.

    Args:
        frames: The episode.
        count: Number of frames, at least 2.

    Returns:
        Indices in order; fewer than ``count`` only if the episode is shorter.
    """
    last = len(frames) - 1
    standing = last
    while standing > 0 and frames[standing - 1].state and frames[last].state:
        standing -= 1
    if frames[last].state:
        settled = frames[standing].time + 0.5
        end = next((i for i, m in enumerate(frames) if m.time >= settled), last)
        chosen = [round(i * end / (count - 2)) for i in range(count - 1)] + [last]
    else:
        chosen = [round(i * last / (count - 1)) for i in range(count)]
    return sorted(set(chosen))


def filmstrip(pictures: Sequence[Image.Image], columns: int = 3, gap: int = 8) -> Image.Image:
    """Put pictures of one size row by row into one, with narrow white gaps."""
    w, h = pictures[0].size
    rows = math.ceil(len(pictures) / columns)
    columns = min(columns, len(pictures))
    strip = Image.new("RGB", (columns * (w + gap) - gap, rows * (h + gap) - gap), "white")
    for i, picture in enumerate(pictures):
        strip.paste(picture, (i % columns * (w + gap), i // columns * (h + gap)))
    return strip


@lru_cache(maxsize=64)
def _font(size: int) -> ImageFont.FreeTypeFont:
    font = ImageFont.load_default(size)
    assert isinstance(font, ImageFont.FreeTypeFont)
    return font
