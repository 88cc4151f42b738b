"""Text in pictures: labels, captions and titles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from PIL import Image, ImageDraw, ImageFont

DECK, GROUND, AIR, FAILED = (46, 184, 114), (226, 230, 236), (110, 118, 130), (235, 104, 92)
PANEL, TEXT, PUSH = (24, 29, 37), (255, 255, 255), (240, 178, 60)

CAPTION = 0.9
"""Size of a caption's letters, as a part of the label's."""


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
        push: Change of the trunk's velocity by a push a moment ago, m/s; 0 for none.
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
    push: float = 0.0
    outcome: str = ""
    succeeded: bool = False

    @property
    def word(self) -> str:
        """The state of the robot in a word: ``start``, the task's word or nothing."""
        return "start" if self.time == 0 else self.state


def draw_overlay(picture: Image.Image, frame: Frame) -> Image.Image:
    """Write the time, the contacts of the feet, a push, and in the last frame the outcome into a picture.

    A foot on the deck is green, one on anything else white, and one in the air gray. At the start nothing is known of
    the contacts, as physics has made no step yet: all feet have a white outline.

    Args:
        picture: The picture; stays unchanged. The label is as large as its height asks for.
        frame: The moment that it shows.

    Returns:
        A picture of the same size.
    """
    result = picture.convert("RGBA")
    size = _letters(*picture.size)
    margin = round(size * 0.7)
    panel = _contacts(frame, size)
    bottom = picture.height - margin - panel.height
    result.alpha_composite(panel, (margin, bottom))
    said = frame.outcome or (f"push {frame.push:.2f} m/s" if frame.push else "")
    if said:
        left, room = 2 * margin + panel.width, picture.width - panel.width - 3 * margin
        if _font(size).getlength(said) + 2 * size > 1.5 * room:
            left, room = margin, picture.width - 2 * margin
            bottom -= panel.height + margin
        ink = PUSH if not frame.outcome else DECK if frame.succeeded else FAILED
        result.alpha_composite(_line(said, size, panel.height, room, ink), (left, bottom))
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


def draw_caption(picture: Image.Image, text: str) -> Image.Image:
    """Write a line of text into the upper left corner of a picture.

    Args:
        picture: The picture; stays unchanged.
        text: The line; empty for none. It becomes smaller, and then loses its beginning, if it is too long.

    Returns:
        A picture of the same size.
    """
    if not text:
        return picture
    result = picture.convert("RGBA")
    size = round(CAPTION * _letters(*picture.size))
    margin = round(size * 0.7)
    panel = _line(text, size, round(size * 1.7), picture.width - 2 * margin, TEXT)
    result.alpha_composite(panel, (margin, margin))
    return result.convert("RGB")


def draw_title(text: str, width: int, height: int, ink: tuple[int, int, int] = TEXT) -> Image.Image:
    """Return a bar with a line of text."""
    bar = Image.new("RGB", (width, height), PANEL)
    if text:
        size = max(5, round(height * 0.55))
        line = _line(text, size, height, width - size, ink)
        bar.paste(line.convert("RGB"), (size // 2, 0), line)
    return bar


def _line(text: str, size: int, height: int, room: int, ink: tuple[int, int, int]) -> Image.Image:
    """Return a panel with a line of text that takes at most ``room`` pixels."""
    smallest = max(5, round(size * 0.6))
    while size > smallest and _font(size).getlength(text) + 2 * size > room:
        size -= 1
    whole = text
    while len(whole) > 1 and _font(size).getlength(text) + 2 * size > room:
        whole = whole[1:]
        text = "…" + whole
    width = min(room, round(_font(size).getlength(text)) + 2 * size)
    panel = Image.new("RGBA", (width * 2, height * 2), (0, 0, 0, 0))
    draw = ImageDraw.Draw(panel)
    draw.rounded_rectangle((0, 0, panel.width - 1, panel.height - 1), radius=height // 2, fill=(*PANEL, 205))
    draw.text((width, height), text, font=_font(size * 2), fill=ink, anchor="mm")
    return panel.resize((width, height), Image.Resampling.LANCZOS)


def rooms(size: tuple[int, int], caption: bool) -> tuple[float, float]:
    """Return the parts of a picture that label and caption take, as shares of half its height.

    Args:
        size: Width and height of the picture, pixels.
        caption: Whether there is a caption.
    """
    letters, half = _letters(*size), size[1] / 2
    # Panel and margin of the label, and of the caption, whose letters are smaller.
    return 3.2 * letters / half, ((2.4 * round(CAPTION * letters) + 1) / half if caption else 0.0)


def _letters(width: int, height: int) -> int:
    """Return the size of the letters in a picture, pixels: in small ones they take a larger part."""
    return max(5, min(round(height * 0.025 + 6), width // 26))


@lru_cache(maxsize=64)
def _font(size: int) -> ImageFont.FreeTypeFont:
    font = ImageFont.load_default(size)
    assert isinstance(font, ImageFont.FreeTypeFont)
    return font
