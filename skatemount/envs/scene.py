"""The scene: robot, board and arena in one model, and the layout of its sensor array.

The model is built once from composer entities. The task reads its state from the model's sensors, which are one
contiguous array in every engine, and from the joint accelerations. `SceneIndex` holds the slices of that array.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import mujoco
import numpy as np
from dm_control import mjcf

from skatemount.envs.config.board import SkateboardConfig
from skatemount.envs.config.physics import SolverConfig
from skatemount.envs.config.robot import RobotConfig
from skatemount.envs.entities.arena import MountArena
from skatemount.envs.entities.quadruped import Quadruped
from skatemount.envs.entities.skateboard import WELD_SOLIMP, WELD_SOLREF, Skateboard
from skatemount.utils.errors import ConfigError

_FOOT_SOLIMP_REST = (0.001, 0.5, 2.0)
"""The last three numbers of the feet's solimp: width of 1 mm, and MuJoCo's own midpoint and power."""

_FOOT_SOLMIX = 1000.0
"""Makes MuJoCo use the foot's solimp in place of an average with that of what it touches."""


class Scene:
    """The arena with the robot and the board in it.

    Args:
        robot: Settings of the robot.
        board: Settings of the skateboard.
        solver: Time step and solver.
        delay_steps: Largest delay of the joint targets, physics steps. Above 0, the model remembers that many targets,
            and ``actuator_delay`` says which of them a world gets.
        boards_vary: True if every world gets a board of its own, with other sizes than this one; see
            `skatemount.envs.boards`.
    """

    def __init__(
        self,
        robot: RobotConfig,
        board: SkateboardConfig,
        solver: SolverConfig,
        delay_steps: int = 0,
        boards_vary: bool = False,
    ):
        self.solver, self.delay_steps, self.boards_vary = solver, delay_steps, boards_vary
        self.arena = MountArena()
        self.robot = Quadruped(config=robot)
        self.board = Skateboard(config=board)
        self.robot_frame = self.arena.add_free_entity(self.robot)
        self.board_frame = self.arena.add_free_entity(self.board)
        self.board_frame.pos = (0.0, 0.0, self.board.config.deck_height)
        # Beside the board, so that the two do not overlap in the model's own start state.
        self.robot_frame.pos = (0.0, 1.0, 0.4)
        root = self.arena.mjcf_model
        self.weld = root.equality.add(
            "weld",
            name="board_fixed",
            body1=self.board_frame,
            solref=WELD_SOLREF,
            solimp=WELD_SOLIMP,
            active=True,
        )
        # Memory for contacts and constraints, which the CPU engine reserves for each world.
        root.size.memory = "1M"
        self._set_options(root)
        for geom in self.robot.foot_geoms:
            geom.set_attributes(solimp=(*solver.foot_impedance, *_FOOT_SOLIMP_REST), solmix=_FOOT_SOLMIX)
        if delay_steps:
            for actuator in self.robot.actuators:
                actuator.set_attributes(delay=delay_steps * solver.timestep, nsample=delay_steps, interp="zoh")
        self._add_cameras()
        self._add_sensors(root)

    @property
    def deck_height(self) -> float:
        """Height of the deck's top above the floor at rest, m."""
        return self.board.config.deck_height

    def compile(self, visuals: bool = True) -> mujoco.MjModel:
        """Compile the scene.

        Args:
            visuals: Keep geoms, materials and textures that are only drawn. Without them a step takes about a fifth
                less time and computes the same.

        Returns:
            A model that owns its memory.
        """
        root = self.arena.mjcf_model
        root.compiler.discardvisual = not visuals
        try:
            physics = mjcf.Physics.from_mjcf_model(root)
        except ValueError as error:
            # MuJoCo names the body or geom, whose name says which group of settings it belongs to.
            reason = " ".join(str(error).split())
            raise ConfigError(f"robot and board cannot be compiled to a scene: {reason}") from error
        finally:
            root.compiler.discardvisual = False
        # A copy, because the physics object frees its model when it is collected.
        return copy.copy(physics.model.ptr)

    def with_board(self, board: SkateboardConfig) -> Scene:
        """Build the same scene with another board."""
        return Scene(self.robot.config, board, self.solver, self.delay_steps, self.boards_vary)

    def xml(self) -> str:
        """Return the scene as MuJoCo's XML, which compiles to the model without what is only drawn."""
        root = self.arena.mjcf_model
        root.compiler.discardvisual = True
        try:
            return str(root.to_xml_string())
        finally:
            root.compiler.discardvisual = False

    def _set_options(self, root: mjcf.RootElement) -> None:
        option = root.option
        option.timestep = self.solver.timestep
        option.integrator = "implicitfast"
        option.solver = self.solver.solver
        option.iterations = self.solver.iterations
        option.ls_iterations = self.solver.ls_iterations
        option.tolerance = self.solver.tolerance
        option.cone = self.solver.cone
        option.impratio = self.solver.impratio

    def _add_cameras(self) -> None:
        self.robot.mjcf_model.worldbody.add(
            "camera",
            name="follow",
            mode="trackcom",
            pos=(0.9, -1.1, 0.55),
            xyaxes=(0.77, 0.63, 0.0, -0.2, 0.25, 0.95),
        )

    def _add_sensors(self, root: mjcf.RootElement) -> None:
        sensor = root.sensor
        robot, board = self.robot, self.board

        def add(kind: str, name: str, **kwargs: object) -> None:
            sensor.add(kind, name=name, **kwargs)

        def add_axes(name: str, **kwargs: object) -> None:
            for i, axis in enumerate("xyz"):
                add(f"frame{axis}axis", f"{name}_axes_{i}", **kwargs)

        base = dict(objtype="site", objname=robot.imu)
        deck = dict(objtype="site", objname=board.deck_site)
        add("framepos", "base_pos", **base)
        add_axes("base", **base)
        add("velocimeter", "base_lin_vel", site=robot.imu)
        add("gyro", "base_ang_vel", site=robot.imu)
        for i, joint in enumerate(robot.joints):
            add("jointpos", f"joint_pos_{i}", joint=joint)
        for i, joint in enumerate(robot.joints):
            add("jointvel", f"joint_vel_{i}", joint=joint)
        for i, joint in enumerate(robot.joints):
            add("jointactuatorfrc", f"joint_torque_{i}", joint=joint)
        # The engine rotates these into their frames, which is cheaper than torch operations on all worlds.
        in_base = dict(reftype="site", refname=robot.imu)
        in_board = dict(reftype="site", refname=board.deck_site)
        for kind, name, reference in (
            ("framepos", "foot_pos", {}),
            ("framelinvel", "foot_vel", {}),
            ("framepos", "foot_pos_base", in_base),
            ("framepos", "foot_pos_board", in_board),
            ("framelinvel", "foot_vel_board", in_board),
        ):
            for i, foot in enumerate(robot.feet):
                add(kind, f"{name}_{i}", objtype="site", objname=foot, **reference)
        add("framepos", "board_pos", **deck)
        add("framepos", "board_pos_base", **deck, **in_base)
        add_axes("board_in_base", **deck, **in_base)
        add_axes("board", **deck)
        add("framelinvel", "board_lin_vel", **deck)
        add("frameangvel", "board_ang_vel", **deck)
        for i, joint in enumerate(board.truck_joints):
            add("jointpos", f"truck_angle_{i}", joint=joint)
        for i, joint in enumerate(board.wheel_joints):
            add("jointvel", f"wheel_speed_{i}", joint=joint)
        contact = dict(data="force", reduce="netforce")
        for i, geom in enumerate(robot.foot_geoms):
            add("contact", f"foot_deck_force_{i}", geom1=geom, geom2=board.deck_geom, **contact)
        for i, geom in enumerate(robot.foot_geoms):
            add("contact", f"foot_force_{i}", geom1=geom, **contact)
        for name, geoms in robot.body_geoms.items():
            for i, geom in enumerate(geoms):
                add("contact", f"body_force_{name}_{i}", geom1=geom, **contact)


@dataclass(frozen=True)
class SceneIndex:
    """Ids and slices of one compiled scene.

    Attributes:
        sensors: Slice of the sensor array, and shape per world, by the name of the `SimState` field or of its source.
        joint_qpos: Addresses of the joints in ``qpos``.
        joint_dof: Addresses of the joints in ``qvel``.
        actuators: Actuator ids in the order of the joints.
        base_qpos: Slice of the robot's free joint in ``qpos``.
        base_dof: Slice of the robot's free joint in ``qvel``.
        robot_body: Body id of the robot's free frame, the parent of the trunk.
        trunk_body: Body id of the trunk.
        robot_bodies: Body ids of the trunk and the legs.
        board_body: Body id of the deck.
        truck_joints: Joint ids of the two trucks.
        touched_geoms: Ids of the geoms whose friction the robot feels: its own, the deck, its floor.
        weld: Equality id of the weld that fixes the board.
        floor_mocap: Mocap id of the robot's floor.
        rolling: ``[nv]`` velocities of the scene while the board, in its start pose, rolls forward at 1 m/s.
        board_qpos: Addresses in ``qpos`` of the deck's free joint and the two trucks.
        board_dof: Addresses in ``qvel`` of the deck's free joint, the two trucks and the four wheels.
    """

    sensors: dict[str, tuple[slice, tuple[int, ...]]]
    joint_qpos: np.ndarray
    joint_dof: np.ndarray
    actuators: np.ndarray
    base_qpos: slice
    base_dof: slice
    robot_body: int
    trunk_body: int
    robot_bodies: np.ndarray
    board_body: int
    truck_joints: np.ndarray
    touched_geoms: np.ndarray
    weld: int
    floor_mocap: int
    rolling: np.ndarray
    board_qpos: np.ndarray
    board_dof: np.ndarray

    @classmethod
    def of(cls, scene: Scene, model: mujoco.MjModel) -> SceneIndex:
        """Look up the ids and slices of a compiled scene.

        Args:
            scene: The scene.
            model: The model that the scene was compiled to.
        """

        def sensor(prefix: str, count: int = 0) -> tuple[slice, tuple[int, ...]]:
            if not count:
                s = model.sensor(prefix)
                return slice(s.adr[0], s.adr[0] + s.dim[0]), (int(s.dim[0]),)
            parts = [model.sensor(f"{prefix}_{i}") for i in range(count)]
            start, dim = int(parts[0].adr[0]), int(parts[0].dim[0])
            # The sensors of a field were added one after the other, so the field is one slice.
            assert [int(p.adr[0]) for p in parts] == [start + i * dim for i in range(count)]
            return slice(start, start + count * dim), (count,) if dim == 1 else (count, dim)

        sensors = {n: sensor(n) for n in ("base_pos", "base_lin_vel", "base_ang_vel")}
        sensors |= {n: sensor(n) for n in ("board_pos", "board_pos_base", "board_lin_vel", "board_ang_vel")}
        sensors |= {n: sensor(n, 3) for n in ("base_axes", "board_axes", "board_in_base_axes")}
        sensors |= {n: sensor(n, len(scene.robot.joints)) for n in ("joint_pos", "joint_vel", "joint_torque")}
        feet = ("foot_pos", "foot_vel", "foot_pos_base", "foot_pos_board", "foot_vel_board")
        sensors |= {n: sensor(n, len(scene.robot.feet)) for n in (*feet, "foot_deck_force", "foot_force")}
        sensors |= {"truck_angle": sensor("truck_angle", len(scene.board.truck_joints))}
        sensors |= {"wheel_speed": sensor("wheel_speed", len(scene.board.wheel_joints))}
        bodies = scene.robot.body_geoms
        assert all(len(geoms) == 1 for geoms in bodies.values()), "body_force has one contact sensor for each body"
        start = int(model.sensor(f"body_force_{next(iter(bodies))}_0").adr[0])
        sensors["body_force"] = (slice(start, start + 3 * len(bodies)), (len(bodies), 3))

        joints = [model.joint(j.full_identifier) for j in scene.robot.joints]
        robot_joint = model.joint(scene.robot_frame.freejoint.full_identifier)
        board_joint = model.joint(scene.board_frame.freejoint.full_identifier)
        rq, rd = int(robot_joint.qposadr[0]), int(robot_joint.dofadr[0])
        trucks, wheels = (
            [model.joint(joint.full_identifier) for joint in joints]
            for joints in (scene.board.truck_joints, scene.board.wheel_joints)
        )
        bq, bd = int(board_joint.qposadr[0]), int(board_joint.dofadr[0])
        rolling = np.zeros(model.nv)
        rolling[bd] = 1.0
        for wheel in wheels:
            rolling[wheel.dofadr[0]] = 1 / scene.board.config.wheel_radius
        floor = model.body(scene.arena.robot_floor.full_identifier)
        touched = [*scene.robot.foot_geoms, scene.board.deck_geom, scene.arena.robot_ground]
        touched += [geom for geoms in scene.robot.body_geoms.values() for geom in geoms]
        robot_body = int(model.jnt_bodyid[robot_joint.id])
        robot_bodies = np.flatnonzero(model.body_rootid == robot_body)
        return cls(
            sensors=sensors,
            joint_qpos=np.array([j.qposadr[0] for j in joints]),
            joint_dof=np.array([j.dofadr[0] for j in joints]),
            actuators=np.array([model.actuator(a.full_identifier).id for a in scene.robot.actuators]),
            base_qpos=slice(rq, rq + 7),
            base_dof=slice(rd, rd + 6),
            robot_body=robot_body,
            trunk_body=int(model.body(scene.robot.trunk.full_identifier).id),
            robot_bodies=robot_bodies[robot_bodies != robot_body],
            board_body=int(model.jnt_bodyid[board_joint.id]),
            truck_joints=np.array([truck.id for truck in trucks]),
            touched_geoms=np.array([model.geom(g.full_identifier).id for g in touched]),
            weld=int(model.equality(scene.weld.full_identifier).id),
            floor_mocap=int(floor.mocapid[0]),
            rolling=rolling,
            board_qpos=np.array([*range(bq, bq + 7), *(t.qposadr[0] for t in trucks)]),
            board_dof=np.array([*range(bd, bd + 6), *(j.dofadr[0] for j in (*trucks, *wheels))]),
        )
