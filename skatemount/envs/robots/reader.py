"""`RobotFile`: a `RobotSpec` read from the URDF or MJCF of a quadruped by MuJoCo's own compiler."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from skatemount.envs.robots.shapes import Solid, leg_radius, one_shape, trunk_box
from skatemount.envs.robots.spec import MAIN_AXES, Inertial, Leg, LegKinematics, Link, RobotSpec, Shape, merge
from skatemount.utils.errors import ConfigError

CLOSE = 1e-3
"""Largest difference, m, between a joint's place and the one that `LegKinematics` assumes."""
FOOT_CLOSE = 5e-3
"""Largest distance, m, between a foot and the axis of its calf; the spec puts it on the axis."""


@dataclass(frozen=True)
class RobotFile:
    """A robot as its file describes it.

    Attributes:
        spec: Numbers and names of the robot.
        torque: Largest torque of the hips' motors, N m; None if the file gives none.
        speed: Largest speed of the hips' motors, rad/s; None if the file gives none.
        notes: What differs from the file, a sentence each.
    """

    spec: RobotSpec
    torque: float | None
    speed: float | None
    notes: tuple[str, ...]


def read_robot(path: Path | str, name: str | None = None, foot_radius: float | None = None) -> RobotFile:
    """Read the URDF or MJCF of a quadruped.

    Bodies that are fixed to a link are merged into it. Meshes that are missing are left out.

    Args:
        path: The file.
        name: Name of the robot; that of the model if None.
        foot_radius: Radius of the feet, m, for a file in which they are meshes.

    Raises:
        ConfigError: MuJoCo cannot read the file, or the robot is none that `RobotSpec` describes; the message names
            the first body or joint that does not fit.
    """
    path = Path(path)
    notes: list[str] = []
    if not path.is_file():
        raise ConfigError(f"{path}: there is no such file")
    try:
        root = ET.parse(path).getroot().tag
    except (ET.ParseError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: must be a URDF or an MJCF, which are XML ({error})") from error
    if root not in ("robot", "mujoco"):
        raise ConfigError(f"{path}: must be a URDF or an MJCF, an XML file of <robot> or <mujoco>, not of <{root}>")
    try:
        model = _compile(path, notes)
    except (ValueError, mujoco.FatalError) as error:
        raise ConfigError(f"{path}: {' '.join(str(error).split())}") from error
    try:
        return _Reader(model, _speeds(path), notes, foot_radius).read(name or _identifier(model.names, path))
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from error


def _compile(path: Path, notes: list[str]) -> mujoco.MjModel:
    """Return the compiled model with its fixed bodies; without its meshes if they cannot be loaded."""
    spec = mujoco.MjSpec.from_file(str(path))
    spec.compiler.fusestatic = False
    try:
        return spec.compile()
    except (ValueError, mujoco.FatalError):
        if not spec.meshes:
            raise
    spec = mujoco.MjSpec.from_file(str(path))
    spec.compiler.fusestatic = False
    for geom in list(spec.geoms):
        if geom.type == mujoco.mjtGeom.mjGEOM_MESH:
            spec.delete(geom)
    for mesh in list(spec.meshes):
        spec.delete(mesh)
    notes.append("Its meshes could not be loaded and are left out.")
    return spec.compile()


def _identifier(names: bytes, path: Path) -> str:
    """Return the model's name, or else the file's, as a name for a robot."""
    model = names.split(b"\0", 1)[0].decode()
    name = model if model and not model.startswith("MuJoCo") else path.stem
    return "".join(each if each.isalnum() else "_" for each in name.lower()).removesuffix("_description")


def _speeds(path: Path) -> dict[str, float]:
    """Return the joints' largest speeds in a URDF, rad/s; MuJoCo does not keep them."""
    limits = {joint.get("name", ""): joint.find("limit") for joint in ET.parse(path).getroot().findall("joint")}
    return {name: float(limit.get("velocity", 0)) for name, limit in limits.items() if limit is not None}


class _Reader:
    """The compiled robot in its zero pose, in the axes of its trunk.

    Args:
        model: The robot alone.
        speeds: Largest speed of each joint that has one, rad/s.
        notes: Sentences are added to it.
        foot_radius: Radius of the feet if the file gives none, m.
    """

    def __init__(self, model: mujoco.MjModel, speeds: dict[str, float], notes: list[str], foot_radius: float | None):
        self._model, self._speeds, self._notes, self._foot_radius = model, speeds, notes, foot_radius
        for joint in range(model.njnt):
            kind = mujoco.mjtJoint(model.jnt_type[joint])
            if kind not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_FREE):
                raise ValueError(f"joint {model.joint(joint).name} must turn about one axis")
        moving = [i for i in range(model.nbody) if self._hinges(i)]
        for body in moving:
            if len(self._hinges(body)) > 1:
                raise ValueError(f"body {model.body(body).name} must have one joint, not {len(self._hinges(body))}")
        links = {body: self._link(body) for body in range(model.nbody)}
        self._parts = {link: [body for body in links if links[body] == link] for link in (0, *moving)}
        self._children: dict[int, list[int]] = defaultdict(list)
        for body in moving:
            self._children[links[int(model.body_parentid[body])]].append(body)
        # The trunk carries the legs; a free or fixed base counts as link 0.
        self._hips = self._children[0]
        self._merged: list[str] = []
        if len(self._hips) != 4:
            raise ValueError(f"the trunk must carry 4 legs, not {len(self._hips)} joints")
        self._trunk = int(model.body_parentid[self._hips[0]])
        if self._trunk == 0:
            raise ValueError("the trunk must be a body of its own, not the world")
        data = mujoco.MjData(model)
        data.qpos[model.jnt_qposadr[model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE]] = 0
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        self._axes = data.xmat[self._trunk].reshape(3, 3).copy()
        self._data, self._origin = data, data.xpos[self._trunk].copy()
        middle = np.mean([self._anchor(hip) for hip in self._hips], axis=0)
        if np.abs(middle[[0, 2]]).max() > 1e-9:
            self._origin = self._origin + self._axes @ (middle * [1, 0, 1])
            self._notes.append(
                f"The trunk's frame is moved by {_vector(middle * [1, 0, 1])} m to the middle of the hips."
            )

    def read(self, name: str) -> RobotFile:
        """Return the robot by the given name."""
        chains = [self._chain(hip) for hip in self._hips]
        order = {int(joint): i for i, (joint, _) in enumerate(self._model.actuator_trnid)}
        chains.sort(key=lambda chain: order.get(self._joint(chain[0]), len(order)))
        for link, wanted in ((chain[i], MAIN_AXES[i]) for chain in chains for i in range(3)):
            axis = self._axes.T @ self._data.xaxis[self._joint(link)]
            if not np.allclose(axis, wanted, atol=1e-3):
                raise ValueError(f"the axis of joint {self._joint_name(link)} must be {_vector(wanted)} in the trunk's "
                                 f"axes, not {_vector(axis)}")  # fmt: skip
        kinematics = self._kinematics(chains)
        torques = [[self._torque(link) for link in chain] for chain in chains]
        spec = RobotSpec(
            name=name,
            trunk=self._model.body(self._trunk).name,
            trunk_inertial=self._inertial(0, np.zeros(3)),
            trunk_shape=self._shape(0, np.zeros(3)) or trunk_box(kinematics, self._notes),
            legs=tuple(self._leg(chain, row, torques[0][0], kinematics) for chain, row in zip(chains, torques)),
            kinematics=kinematics,
            leg_radius=max(
                kinematics.foot_radius,
                *(leg_radius(self._shape(body, self._anchor(body))) for chain in chains for body in chain[1:3]),
            ),
        )
        if merged := list(dict.fromkeys(self._merged)):
            self._notes.append(f"One shape stands for the several collision shapes of each of {', '.join(merged)}.")
        speed = self._speeds.get(self._joint_name(chains[0][0])) or None
        if torques[0][0] is None:
            self._notes.append("It gives no torque limits: set robot.torque_limit, and the links' reductions.")
        return RobotFile(spec, torques[0][0], speed, tuple(dict.fromkeys(self._notes)))

    def _hinges(self, body: int) -> list[int]:
        first, count = int(self._model.body_jntadr[body]), int(self._model.body_jntnum[body])
        hinge = mujoco.mjtJoint.mjJNT_HINGE
        return [joint for joint in range(first, first + count) if self._model.jnt_type[joint] == hinge]

    def _link(self, body: int) -> int:
        """Return the moving body to which a body is fixed, 0 for the trunk."""
        while body and not self._hinges(body):
            body = int(self._model.body_parentid[body])
        return body

    def _joint(self, body: int) -> int:
        return self._hinges(body)[0]

    def _joint_name(self, body: int) -> str:
        return self._model.joint(self._joint(body)).name

    def _in_trunk(self, point: np.ndarray) -> np.ndarray:
        return self._axes.T @ (point - self._origin)

    def _anchor(self, body: int) -> np.ndarray:
        """Return the place of a link's joint in the trunk frame, m."""
        return self._in_trunk(self._data.xanchor[self._joint(body)])

    def _chain(self, hip: int) -> list[int]:
        """Return the links of a leg from the trunk outward."""
        chain = [hip]
        while further := self._children[chain[-1]]:
            if len(further) > 1:
                raise ValueError(
                    f"body {self._model.body(chain[-1]).name} must carry one further link, not {len(further)}"
                )
            chain += further
        if len(chain) < 3:
            raise ValueError(f"the leg of {self._model.body(hip).name} must have 3 or more joints, not {len(chain)}")
        return chain

    def _kinematics(self, chains: list[list[int]]) -> LegKinematics:
        """Return the legs' dimensions, and check that every joint is where they put it."""
        first, radius = chains[0], self._foot(chains[0])[2]
        hip, thigh, calf = (self._anchor(body) for body in first[:3])
        length = self._anchor(first[2])[2] - self._foot(first)[1][2]
        found = LegKinematics(*(_rounded(x) for x in (
            abs(hip[0]), abs(hip[1]), abs(thigh[1] - hip[1]), thigh[2] - calf[2], length, radius
        )))  # fmt: skip
        for chain in chains:
            hip, foot = self._anchor(chain[0]), self._foot(chain)[1]
            front, left = np.sign(hip[0]), np.sign(hip[1])
            places = [
                np.array([front * found.hip_x, left * found.hip_y, 0]),
                np.array([0, left * found.thigh_y, 0]),
                np.array([0, 0, -found.thigh_length]),
                np.array([0, 0, -found.calf_length]),
            ]
            expected = np.cumsum(places, axis=0)
            for i, body in enumerate(chain):
                place = expected[min(i, 3)]
                if np.abs(self._anchor(body) - place).max() > CLOSE:
                    raise ValueError(_misplaced(f"joint {self._joint_name(body)}", place, self._anchor(body)))
            off = float(np.linalg.norm(foot - expected[3]))
            where = f"the foot of {self._model.body(chain[-1]).name}"
            if off > FOOT_CLOSE:
                raise ValueError(_misplaced(where, expected[3], foot))
            if off > 1e-6:
                self._notes.append(
                    f"The feet are {1000 * off:.1f} mm off the calves' axes; the spec puts them on these."
                )
        return found

    def _foot(self, chain: list[int]) -> tuple[str, np.ndarray, float]:
        """Return name, center in the trunk frame and radius of the foot: the sphere at the last link's end."""
        model, last = self._model, chain[-1]
        end = self._anchor(chain[2])
        spheres = [g for g in self._geoms(last) if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_SPHERE]
        bodies = [body for body in self._parts[last] if body != last and "foot" in model.body(body).name.lower()]
        if spheres:
            geom = max(spheres, key=lambda g: np.linalg.norm(self._in_trunk(self._data.geom_xpos[g]) - end))
            body = int(model.geom_bodyid[geom])
            name = model.body(body).name if body != last else model.geom(geom).name
            return name, self._in_trunk(self._data.geom_xpos[geom]), float(model.geom_size[geom, 0])
        if bodies and self._foot_radius:
            return model.body(bodies[0]).name, self._in_trunk(self._data.xpos[bodies[0]]), self._foot_radius
        raise ValueError(f"body {model.body(last).name} must end in a foot: a sphere that collides, or, with "
                         "--foot-radius, a fixed body with foot in its name")  # fmt: skip

    def _leg(self, chain: list[int], torques: list[float | None], motor: float | None, kin: LegKinematics) -> Leg:
        front, left = (float(x) for x in np.sign(self._anchor(chain[0])[:2]))
        joints = [self._joint_name(body) for body in chain]
        own = os.path.commonprefix(joints).rstrip("_-. /")
        name = own or f"{'F' if front > 0 else 'R'}{'L' if left > 0 else 'R'}"
        links = []
        lowest = kin.foot_radius - kin.calf_length
        for body, joint, torque in zip(chain, joints, torques):
            axis = self._axes.T @ self._data.xaxis[self._joint(body)]
            x, y, z = (_rounded(each) for each in axis.round(6))
            low, high = (_rounded(each) for each in self._model.jnt_range[self._joint(body)])
            if not self._model.jnt_limited[self._joint(body)]:
                raise ValueError(f"joint {joint} must have a range")
            shape = self._shape(body, self._anchor(body), lowest if body == chain[2] else -np.inf)
            reduction = torque / motor if torque and motor else 1.0
            inertial = self._inertial(body, self._anchor(body))
            name_of = self._model.body(body).name
            links.append(Link(name_of, joint, (x, y, z), (low, high), inertial, shape, _rounded(reduction)))
        foot = self._foot(chain)[0] or f"{name}_foot"
        return Leg(name, front, left, foot, tuple(links))

    def _torque(self, body: int) -> float | None:
        """Return the largest torque of a link's motor, N m; None if there is no limit."""
        model, joint = self._model, self._joint(body)
        found = []
        if model.jnt_actfrclimited[joint]:
            found.append(model.jnt_actfrcrange[joint, 1])
        for i in np.flatnonzero(model.actuator_trnid[:, 0] == joint):
            gear = abs(model.actuator_gear[i, 0])
            if model.actuator_forcelimited[i]:
                found.append(model.actuator_forcerange[i, 1] * gear)
            elif model.actuator_ctrllimited[i] and model.actuator_biastype[i] == mujoco.mjtBias.mjBIAS_NONE:
                found.append(model.actuator_ctrlrange[i, 1] * model.actuator_gainprm[i, 0] * gear)
        return _rounded(min(found)) if found else None

    def _inertial(self, link: int, origin: np.ndarray) -> Inertial:
        """Return the inertial of a link and all that is fixed to it, about an origin in the trunk frame."""
        total: Inertial | None = None
        for body in self._parts[link]:
            mass = float(self._model.body_mass[body])
            if mass <= 0:
                continue
            rotation = self._axes.T @ self._data.ximat[body].reshape(3, 3)
            inertia = rotation @ np.diag(self._model.body_inertia[body]) @ rotation.T
            part = Inertial(mass, self._in_trunk(self._data.xipos[body]) - origin, (inertia + inertia.T) / 2)
            total = part if total is None else merge(total, part)
        if total is None:
            raise ValueError(f"body {self._model.body(link or self._trunk).name} must have a mass")
        inertia = np.array([[_rounded(each) for each in row] for row in total.inertia])
        return Inertial(_rounded(total.mass), np.array([_rounded(each) for each in total.com]), inertia)

    def _geoms(self, link: int) -> list[int]:
        """Return the geoms of a link that can touch something."""
        model = self._model
        return [
            geom
            for geom in range(model.ngeom)
            if model.geom_bodyid[geom] in self._parts[link]
            and (model.geom_contype[geom] or model.geom_conaffinity[geom])
        ]

    def _shape(self, link: int, origin: np.ndarray, lowest: float = -np.inf) -> Shape | None:
        """Return the collision shape of a link in its own frame, None without one; see `one_shape`."""
        model, solids = self._model, []
        for geom in self._geoms(link):
            if model.geom_bodyid[geom] == 0 or link and model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_SPHERE:
                continue
            solids.append(
                Solid(
                    mujoco.mjtGeom(model.geom_type[geom]),
                    model.geom_size[geom],
                    self._in_trunk(self._data.geom_xpos[geom]) - origin,
                    self._axes.T @ self._data.geom_xmat[geom].reshape(3, 3),
                    model.geom_aabb[geom],
                )
            )
        if len(solids) > 1:
            self._merged.append(model.body(link or self._trunk).name)
        return one_shape(solids, lowest)


def _misplaced(what: str, place: np.ndarray, found: np.ndarray) -> str:
    """Return the message about a joint or foot that is not where `LegKinematics` puts it."""
    return f"{what} must be at {_vector(place)} m in the trunk's frame (LegKinematics), not at {_vector(found)}"


def _rounded(value: float) -> float:
    """Return a number with 9 digits, without the rounding errors of frames and quaternions."""
    return 0.0 if abs(value) < 1e-12 else float(f"{value:.9g}")


def _vector(values: np.ndarray | tuple[float, ...]) -> str:
    return f"({', '.join(f'{each + 0.0:.6g}' for each in np.round(values, 6))})"
