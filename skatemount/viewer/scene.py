"""The 3D scene of the page, drawn by mjviser."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import torch

from skatemount.envs.geometry import quat_from_matrix
from skatemount.viewer.poses import PoseReader, feet, sensed_board
from skatemount.viewer.session import Session

CAMERAS: dict[str, tuple[float, float, float] | None] = {
    "follow": (-1.1, -1.5, 0.9),
    "side": (0.0, -2.0, 0.25),
    "top": (0.0, -0.01, 2.8),
    "free": None,
}
"""Place of each camera relative to the robot, m; None for one that stays where the user puts it."""

METERS_PER_NEWTON = 0.004
"""Length of the arrows of contact forces."""


class SceneView:
    """The worlds of a session in the browser.

    Args:
        server: The viser server.
        session: The session.
        plain: See `plain`.

    Attributes:
        camera: One of `CAMERAS`; all but ``free`` move with the selected robot.
        only_selected: Draw the selected world alone.
        show_forces: Draw the contact forces of the selected robot's feet.
        show_sensed: Draw the board of the selected world where the policy's sensors see it.
        plain: Draw without shadows and reflections, which are slow in a browser without a GPU.
    """

    def __init__(self, server: Any, session: Session, plain: bool = False):
        self._server, self._session, self.plain = server, session, plain
        self.camera = "follow"
        self.only_selected = False
        self.show_forces = self.show_sensed = True
        self._built = 0
        self._center = np.zeros(3)

    def rebuild(self) -> None:
        """Draw the scene again if the session's worlds are others."""
        session = self._session
        if self._built == session.builds:
            return
        from mjviser import ViserMujocoScene

        self._built = session.builds
        self._server.scene.reset()
        self._reader = PoseReader(session.env)
        scene = self._scene = ViserMujocoScene(self._server, self._reader.model, session.worlds)
        scene.camera_tracking_enabled = False
        # The scene puts its fixed bodies back to the origin at each update; they are moved with the camera instead.
        stand_in: Any = SimpleNamespace()
        self._fixed, scene.fixed_bodies_frame = scene.fixed_bodies_frame, stand_in
        self._root = int(self._reader.model.body_rootid[session.env.physics.index.trunk_body])
        empty = np.zeros((0, 2, 3), np.float32)
        self._arrows = self._server.scene.add_arrows(
            "/forces", empty, (225, 60, 50), shaft_radius=0.006, head_radius=0.015, head_length=0.03
        )
        half = session.env.mdp.context.deck_half
        self._ghost = self._server.scene.add_box(
            "/sensed_board",
            color=(240, 130, 30),
            dimensions=(2 * half[0], 2 * half[1], 0.008),
            opacity=0.55,
            visible=False,
        )
        self.set_plain(self.plain)
        self._center = self._reader.bodies().xpos[session.selected, self._root]

    def set_plain(self, plain: bool) -> None:
        """Draw with shadows and reflections, or without."""
        self.plain = plain
        scene = self._server.scene
        scene.configure_default_lights(cast_shadow=not plain)
        scene.configure_environment_map(None if plain else "warehouse", environment_intensity=0.8)
        # In place of the light of the surroundings.
        scene.add_light_hemisphere("/sky", ground_color=(170, 170, 170), intensity=1.5, visible=plain)
        if (floor := scene.get_handle_by_name("/fixed_bodies/world/floor")) is not None:
            floor.plane_opacity, floor.shadow_opacity = (0.0, 0.0) if plain else (0.4, 0.2)

    def stepped(self) -> None:
        """Read the poses after a control step."""
        self.rebuild()
        self._reader.read(self._session.fresh)

    def show(self, share: float = 1.0) -> None:
        """Send the poses to the browser.

        Args:
            share: Part of the last control step that has passed, 0 to 1.
        """
        self.rebuild()
        session, world = self._session, self._session.selected
        bodies = self._reader.bodies(share)
        if self.camera != "free":
            self._center = bodies.xpos[world, self._root] * [1.0, 1.0, 0.0]
        shift = -self._center * [1.0, 1.0, 0.0]
        scene = self._scene
        scene.show_only_selected, scene.env_idx = self.only_selected, world
        with self._server.atomic():
            self._fixed.position = shift
            self._show_forces(world, shift)
            self._show_sensed(world, shift)
            scene.update_from_arrays(
                bodies.xpos + shift, bodies.xmat, bodies.mocap_pos + shift, bodies.mocap_quat, session.selected
            )

    def place_camera(self, client: Any) -> None:
        """Put a client's camera where the chosen view begins."""
        place = CAMERAS[self.camera]
        if place is not None:
            client.camera.position = (place[0], place[1], place[2] + 0.25)
            client.camera.look_at = (0.0, 0.0, 0.25)

    def _show_forces(self, world: int, shift: np.ndarray) -> None:
        arrows = np.zeros((0, 2, 3), np.float32)
        if self.show_forces:
            found, places = feet(self._session, world)
            pressed = np.array([foot.where != "air" for foot in found])
            begin = places[pressed, 0] + self._reader.places[world] + shift
            arrows = np.stack((begin, begin + METERS_PER_NEWTON * places[pressed, 1]), 1).astype(np.float32)
        self._arrows.visible = bool(len(arrows))
        if len(arrows):
            self._arrows.points = arrows

    def _show_sensed(self, world: int, shift: np.ndarray) -> None:
        seen = sensed_board(self._session, world) if self.show_sensed else None
        self._ghost.visible = seen is not None
        if seen is not None:
            self._ghost.position = seen[0] + self._reader.places[world] + shift
            self._ghost.wxyz = quat_from_matrix(torch.from_numpy(seen[1]).unsqueeze(0))[0].numpy()
