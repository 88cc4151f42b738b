"""Poses of the bodies of a session's worlds, for a display."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np
from torch import Tensor

from skatemount.envs.mount_env import MountEnv
from skatemount.viewer.session import Session

PRESSED = 1.0
"""Force from which a foot counts as in contact, N."""


@dataclass
class Bodies:
    """Poses of the bodies of every world, each in its own place of the grid.

    Attributes:
        xpos: ``[N, B, 3]`` positions, m.
        xmat: ``[N, B, 3, 3]`` axes (columns).
        mocap_pos: ``[N, M, 3]`` positions of the mocap bodies, m.
        mocap_quat: ``[N, M, 4]`` their rotations.
    """

    xpos: np.ndarray
    xmat: np.ndarray
    mocap_pos: np.ndarray
    mocap_quat: np.ndarray


class PoseReader:
    """Computes the poses of a session's worlds, also between two control steps.

    Args:
        env: The worlds.

    Attributes:
        model: The scene with everything that is visible.
        places: ``[N, 3]`` origins of the worlds in the grid, m.
    """

    def __init__(self, env: MountEnv):
        self.model, self._data = env.physics.render_data(0)
        self._env = env
        self.places = grid(env.num_worlds, spacing(env))
        self._now = self._before = env.physics.poses(slice(None))

    def read(self, jumped: np.ndarray) -> None:
        """Read the poses after a control step.

        Args:
            jumped: ``[N]`` bool, worlds that are not where the step began, such as after a reset.
        """
        self._before, self._now = self._now, self._env.physics.poses(slice(None))
        qpos, mocap = self._before
        qpos[jumped], mocap[jumped] = self._now[0][jumped], self._now[1][jumped]

    def bodies(self, share: float = 1.0) -> Bodies:
        """Return the poses of all bodies.

        Args:
            share: Part of the last control step that has passed, 0 to 1.
        """
        model, data = self.model, self._data
        n = len(self.places)
        xpos, xmat = np.empty((n, model.nbody, 3)), np.empty((n, model.nbody, 9))
        mocap = np.empty((n, model.nmocap, 3))
        (before, mocap_before), (now, mocap_now) = self._before, self._now
        change = np.empty(model.nv)
        for i in range(n):
            data.qpos[:] = now[i]
            if share < 1:
                mujoco.mj_differentiatePos(model, change, 1.0, before[i], now[i])
                data.qpos[:] = before[i]
                mujoco.mj_integratePos(model, data.qpos, change, share)
            data.mocap_pos[:] = mocap_before[i] + share * (mocap_now[i] - mocap_before[i])
            mujoco.mj_kinematics(model, data)
            xpos[i], xmat[i], mocap[i] = data.xpos, data.xmat, data.mocap_pos
        place = self.places[:, None]
        quat = np.tile(data.mocap_quat, (n, 1, 1))
        return Bodies(xpos + place, xmat.reshape(n, -1, 3, 3), mocap + place, quat)


def spacing(env: MountEnv) -> float:
    """Return the distance between worlds in the grid at which robots start well apart, m."""
    start = env.task.config.start
    reach = max(map(abs, start.distance or [*start.x, *start.y]))
    return 2 * min(reach, 4.0) + 1.5


def grid(n: int, distance: float) -> np.ndarray:
    """Return ``[n, 3]`` places in a square grid, m; the first is the origin."""
    columns = math.ceil(math.sqrt(n))
    return np.array([[distance * (i % columns), distance * (i // columns), 0.0] for i in range(n)])


@dataclass
class Foot:
    """A foot's contact.

    Attributes:
        name: Name of its leg.
        where: ``deck``, ``ground`` or ``air``.
        force: Size of the contact force, N.
    """

    name: str
    where: str
    force: float


def feet(session: Session, world: int) -> tuple[list[Foot], np.ndarray]:
    """Return the contacts of the feet of a world, and ``[F, 2, 3]`` their places and the forces on them, m and N."""
    sim, episode = session.env.sim, session.env.episode
    deck, other = sim.foot_deck_force[world], sim.foot_other_force[world]
    # The state has the forces that the feet press with; what carries the robot points the other way.
    total = -(deck + other).cpu().numpy()
    found = []
    for i, name in enumerate(session.env.mdp.context.layout.legs):
        where = "deck" if episode.on_deck[world, i] else "ground" if other[i].norm() > PRESSED else "air"
        found.append(Foot(name, where, float(np.linalg.norm(total[i]))))
    return found, np.stack((sim.foot_pos[world].cpu().numpy(), total), 1)


def sensed_board(session: Session, world: int) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the place ``[3]`` and axes ``[3, 3]`` of the deck in the world as the policy's sensors show it.

    None if the policy senses the true pose, and before the first step of an episode.
    """
    sim, sensed = session.env.sim, session.env.mdp.sensed
    if sensed is None or not session.env.mdp.sensing.active or session.fresh[world]:
        return None

    def of(values: Tensor) -> np.ndarray:
        return values[world].cpu().numpy()

    rotation = of(sim.base_rot)
    return of(sim.base_pos) + rotation @ of(sensed.board_pos_base), rotation @ of(sensed.board_rot_base)
