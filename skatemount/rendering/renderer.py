"""Pictures of an episode."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence

import mujoco
import numpy as np
from PIL import Image

from skatemount.rendering import opengl
from skatemount.rendering.camera import FIELD_OF_VIEW
from skatemount.rendering.overlay import DECK, Frame
from skatemount.utils.errors import ConfigError

OVERSAMPLING = 1.25
"""Pictures are drawn larger by this factor and shrunk. Without a graphics card this smooths edges in about half of the
time that OpenGL's own antialiasing takes."""

SHADOW_SIZE = 1280
SHADOW_SCALE = 0.13
"""Resolution of the shadow, and its part of the light's cone: 3 mm on the floor, as the light follows the robot."""


PLAIN = (0.92, 0.93, 0.94)
"""Color of the sky, and of the lit floor, in front of a plain background."""

GLOW, LIT = 1.2, 2.2
"""Light that a plain floor gives by itself, for an even color and soft shadows, and the same with that of the lamps."""


class EpisodeRenderer:
    """Draws frames of an episode.

    Args:
        model: The scene with everything that is visible; stays unchanged.
        feet: Geom ids of the feet; they are painted green while they are on the deck.
        width: Pixels.
        height: Pixels.
        plain: Whether floor and sky have one color, without tiles.

    Attributes:
        size: Width and height.

    Raises:
        ConfigError: There is no OpenGL.
    """

    def __init__(self, model: mujoco.MjModel, feet: Sequence[int], width: int, height: int, plain: bool = False):
        self.size = (width, height)
        self._model = model = copy.copy(model)
        if plain:
            _make_plain(model)
        self._data = mujoco.MjData(model)
        self._feet = [_same_place(model, foot) for foot in feet]
        self._lights = np.flatnonzero(model.light_castshadow)
        self._light_pos = model.light_pos[self._lights].copy()
        drawn = [math.ceil(each * OVERSAMPLING) for each in self.size]
        vis = model.vis
        vis.global_.fovy = FIELD_OF_VIEW
        vis.global_.offwidth, vis.global_.offheight = drawn
        vis.quality.offsamples, vis.quality.shadowsize, vis.map.shadowscale = 0, SHADOW_SIZE, SHADOW_SCALE
        vis.quality.numslices, vis.quality.numstacks = 12, 6
        try:
            self._renderer = mujoco.Renderer(model, height=drawn[1], width=drawn[0])
        except Exception as error:  # each OpenGL library fails in its own way
            reason = " ".join(str(error).split())
            raise ConfigError(f"cannot draw: {reason}. {opengl.ADVICE}") from error
        # A reflection draws the scene once more.
        self._renderer.scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False

    def draw(self, frame: Frame, camera: mujoco.MjvCamera) -> Image.Image:
        """Return the picture of a frame, without label."""
        model, data, scene = self._model, self._data, self._renderer.scene
        data.qpos[:], data.mocap_pos[:] = frame.qpos, frame.mocap_pos
        # The shadow's resolution is spent around the robot.
        model.light_pos[self._lights] = self._light_pos + [*camera.lookat[:2], 0.0]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        self._renderer.update_scene(data, camera)
        painted = {geom for foot, on_deck in zip(self._feet, frame.on_deck, strict=True) if on_deck for geom in foot}
        for geom in scene.geoms[: scene.ngeom]:
            if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM and geom.objid in painted:
                geom.rgba[:3] = np.array(DECK) / 255
                geom.emission = 0.3
        return Image.fromarray(self._renderer.render()).resize(self.size, Image.Resampling.BOX)

    def close(self) -> None:
        """Free the OpenGL context."""
        self._renderer.close()


def _make_plain(model: mujoco.MjModel) -> None:
    """Give the visible floor and the sky one color."""
    floor = (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE) & (model.geom_rgba[:, 3] > 0) & (model.geom_matid >= 0)
    for material in np.unique(model.geom_matid[floor]):
        model.mat_texid[material] = -1
        model.mat_rgba[material, :3] = np.array(PLAIN) / LIT
        model.mat_emission[material] = GLOW
        model.mat_specular[material] = model.mat_reflectance[material] = 0.0
    model.light_exponent[:] = 0.0  # even light, however far the floor is
    model.vis.rgba.haze[:3] = model.vis.rgba.fog[:3] = PLAIN
    for texture in np.flatnonzero(model.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX):
        start, channels = model.tex_adr[texture], model.tex_nchannel[texture]
        size = model.tex_height[texture] * model.tex_width[texture] * channels
        model.tex_data[start : start + size] = np.tile(np.round(255 * np.array(PLAIN)), size // channels)


def _same_place(model: mujoco.MjModel, geom: int) -> list[int]:
    """Return the geoms with the body and the place of one: collision geoms are not drawn, their visual twins are."""
    same = (model.geom_bodyid == model.geom_bodyid[geom]) & (model.geom_pos == model.geom_pos[geom]).all(1)
    return np.flatnonzero(same).tolist()
