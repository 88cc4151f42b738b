"""Pictures of an episode: frames with labels, and the filmstrip made of six of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from skatemount.envs.entities.a1_links import LEGS
from skatemount.rendering import opengl
from skatemount.utils.errors import ConfigError

FIELD_OF_VIEW = 32.0
"""Vertical, degrees; narrow, so that what is near does not look large."""
AZIMUTH, ELEVATION = 128.0, -20.0
"""Where the camera looks to, degrees: from the front right, a little from above."""

MARGIN, LABEL_ROOM = 0.93, 0.24
"""Shares of half a picture: what is filled, and what of it is kept free at the bottom."""

DECK, GROUND, AIR = (46, 184, 114), (226, 230, 236), (92, 100, 112)
PANEL, TEXT = (24, 29, 37), (255, 255, 255)


@dataclass
class Frame:
    """What a label says and a picture shows.

    Attributes:
        time: Seconds since the start of the episode.
        on_deck: Which feet press on the deck.
        touching: Which feet touch anything.
        mounted: Whether the robot stands on the board.
        qpos: ``[nq]`` generalised positions.
        mocap_pos: ``[nmocap, 3]`` m.
    """

    time: float
    on_deck: Sequence[bool]
    touching: Sequence[bool]
    mounted: bool
    qpos: np.ndarray
    mocap_pos: np.ndarray


class EpisodeRenderer:
    """Draws frames of an episode with a camera that stands still.

    Args:
        model: The scene with everything there is to see; its field of view is set.
        subjects: ``[K, 3]`` points that have to be in the picture, m.
        feet: Geom ids of the four feet, as the model numbers them; painted green while they are on the deck.
        width: Pixels.
        height: Pixels.

    Attributes:
        size: Width and height.

    Raises:
        ConfigError: There is no OpenGL.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        subjects: np.ndarray,
        feet: Sequence[int],
        width: int = 960,
        height: int = 720,
    ):
        self.size = (width, height)
        self._model, self._data = model, mujoco.MjData(model)
        model.vis.global_.fovy = FIELD_OF_VIEW
        # Round enough, and twice as fast without a graphics card, where a film takes most of its time.
        model.vis.quality.numslices, model.vis.quality.numstacks = 20, 10
        self._feet = [_same_place(model, foot) for foot in feet]
        self._camera = frame_camera(subjects, width / height)
        try:
            self._renderer = mujoco.Renderer(model, height=height, width=width)
        except Exception as error:  # each OpenGL library fails in its own way
            reason = " ".join(str(error).split())
            raise ConfigError(f"cannot draw: {reason}. {opengl.ADVICE}") from error

    def draw(self, frame: Frame) -> Image.Image:
        """The picture of a frame, without label."""
        self._data.qpos[:], self._data.mocap_pos[:] = frame.qpos, frame.mocap_pos
        mujoco.mj_forward(self._model, self._data)
        self._renderer.update_scene(self._data, self._camera)
        painted = {geom for foot, on_deck in zip(self._feet, frame.on_deck, strict=True) if on_deck for geom in foot}
        scene = self._renderer.scene
        for geom in scene.geoms[: scene.ngeom]:
            if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM and geom.objid in painted:
                geom.rgba[:3] = np.array(DECK) / 255
                geom.emission = 0.3
        return Image.fromarray(self._renderer.render())

    def close(self) -> None:
        """Free the OpenGL context."""
        self._renderer.close()


def _same_place(model: mujoco.MjModel, geom: int) -> list[int]:
    """Geoms with the body and the place of one: what collides is not what is seen."""
    same = (model.geom_bodyid == model.geom_bodyid[geom]) & (model.geom_pos == model.geom_pos[geom]).all(1)
    return np.flatnonzero(same).tolist()


def frame_camera(subjects: np.ndarray, aspect: float) -> mujoco.MjvCamera:
    """The nearest camera at rest that has all points in its picture, with room below them for a label.

    A point at (x, y, z) along the camera's right, up and forward axes is in the picture of a camera at (a, b, -d) if
    -l (z + d) <= x - a <= r (z + d), where l and r are the tangents of the picture's edges, and likewise for y: so the
    smallest d in each direction is (max(x - r z) - min(x + l z)) / (l + r).

    Args:
        subjects: ``[K, 3]``, m.
        aspect: Width of the picture by its height.

    Returns:
        The camera, for a field of view of `FIELD_OF_VIEW`.
    """
    azimuth, elevation = math.radians(AZIMUTH), math.radians(ELEVATION)
    forward = np.array([*(math.cos(elevation) * np.array([math.cos(azimuth), math.sin(azimuth)])), math.sin(elevation)])
    right = np.array([math.sin(azimuth), -math.cos(azimuth), 0.0])
    axes = np.stack((right, np.cross(right, forward), forward))
    seen = subjects @ axes.T
    edge = math.tan(math.radians(FIELD_OF_VIEW / 2))
    low = edge * np.array([MARGIN * aspect, MARGIN - LABEL_ROOM])
    high = edge * np.array([MARGIN * aspect, MARGIN])
    depth = seen[:, 2:]
    from_low, from_high = (seen[:, :2] + low * depth).min(0), (seen[:, :2] - high * depth).max(0)
    distance = float(((from_high - from_low) / (low + high)).max())
    place = (from_high - high * distance + from_low + low * distance) / 2
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.lookat[:] = np.append(place, 0.0) @ axes
    camera.distance, camera.azimuth, camera.elevation = distance, AZIMUTH, ELEVATION
    return camera


def draw_overlay(picture: Image.Image, frame: Frame, scale: float = 1.0) -> Image.Image:
    """Write time, feet in contact and whether the robot is mounted into a picture.

    A foot on the deck is green, one on anything else white, one in the air grey.

    Args:
        picture: The picture; left as it is.
        frame: What it shows.
        scale: Size of the writing.

    Returns:
        A picture of the same size.
    """
    size = round(24 * scale)
    font, bold = _font(size), _font(round(size * 0.88))
    pad, gap, margin = round(size * 0.5), round(size * 0.38), round(size * 0.7)
    pill_w, row_h = round(size * 1.95), round(size * 1.5)
    time_w = round(font.getlength("00.00 s")) + 2 * gap
    word_w = round(bold.getlength("mounted")) + 2 * pad
    width = pad * 2 + time_w + 4 * pill_w + 3 * gap + (gap + word_w if frame.mounted else 0)
    left, top = margin, picture.height - margin - row_h - 2 * pad

    # Drawn twice as large and shrunk: Pillow does not smooth the edges of shapes.
    panel = Image.new("RGBA", (width * 2, (row_h + 2 * pad) * 2), (0, 0, 0, 0))
    draw = ImageDraw.Draw(panel)
    draw.rounded_rectangle((0, 0, panel.width - 1, panel.height - 1), radius=pad * 2, fill=(*PANEL, 205))
    middle = panel.height / 2

    def pill(x: int, w: int, text: str, fill: tuple[int, ...] | None, ink: tuple[int, ...]) -> None:
        box = (x * 2, pad * 2, (x + w) * 2, (pad + row_h) * 2)
        if fill is not None:
            draw.rounded_rectangle(box, radius=row_h * 0.6, fill=fill)
        draw.text((box[0] + w, middle), text, font=_font(round(size * 0.88) * 2), fill=ink, anchor="mm")

    draw.text((pad * 2 + 4, middle), f"{frame.time:.2f} s", font=_font(size * 2), fill=TEXT, anchor="lm")
    x = pad + time_w
    for leg, deck, touch in zip(LEGS, frame.on_deck, frame.touching, strict=True):
        if deck:
            pill(x, pill_w, leg, DECK, TEXT)
        elif touch:
            pill(x, pill_w, leg, GROUND, PANEL)
        else:
            pill(x, pill_w, leg, None, (*AIR, 255))
        x += pill_w + gap
    if frame.mounted:
        pill(x, word_w, "mounted", None, DECK)
    result = picture.convert("RGBA")
    result.alpha_composite(panel.resize((width, row_h + 2 * pad), Image.Resampling.LANCZOS), (left, top))
    return result.convert("RGB")


def choose_frames(frames: Sequence[Frame], count: int = 6) -> list[int]:
    """Which frames a filmstrip shows: where something happens.

    The first and the last frame, and between them frames at equal distances from the start to half a second after the
    robot has come to stand on the board, or to the end if it never stands there.

    Args:
        frames: The episode.
        count: How many, at least 2.

    Returns:
        Indices in order; fewer than ``count`` only if the episode is shorter.
    """
    last = len(frames) - 1
    standing = last
    while standing > 0 and frames[standing - 1].mounted and frames[last].mounted:
        standing -= 1
    if frames[last].mounted:
        settled = frames[standing].time + 0.5
        end = next((i for i, m in enumerate(frames) if m.time >= settled), last)
        chosen = [round(i * end / (count - 2)) for i in range(count - 1)] + [last]
    else:
        chosen = [round(i * last / (count - 1)) for i in range(count)]
    return sorted(set(chosen))


def filmstrip(pictures: Sequence[Image.Image], columns: int = 3, gap: int = 8) -> Image.Image:
    """Pictures of one size, row by row, with narrow white gaps."""
    w, h = pictures[0].size
    rows = math.ceil(len(pictures) / columns)
    columns = min(columns, len(pictures))
    strip = Image.new("RGB", (columns * (w + gap) - gap, rows * (h + gap) - gap), "white")
    for i, picture in enumerate(pictures):
        strip.paste(picture, (i % columns * (w + gap), i // columns * (h + gap)))
    return strip


@lru_cache(maxsize=16)
def _font(size: int) -> ImageFont.FreeTypeFont:
    font = ImageFont.load_default(size)
    assert isinstance(font, ImageFont.FreeTypeFont)
    return font
