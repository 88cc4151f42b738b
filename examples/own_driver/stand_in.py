"""A stand-in for a robot's drivers: MuJoCo moves the exported scene with plain PD motors."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np


class Bus:
    """Drivers of motors, inertial measurement unit and camera, with conventions that are not those of the policy.

    Args:
        folder: The exported policy.
        card: Its card.
        start: Position of the trunk in the world, x and y in m, with the board at the origin.
    """

    camera_pos = np.array([0.25, 0.0, 0.05])
    """Place of the camera in the trunk frame, m."""
    camera_rot = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    """Axes of the camera in the trunk frame, as columns: right, down, forward."""

    def __init__(self, folder: Path, card: Mapping[str, Any], start: tuple[float, float] = (0.1, 0.7)):
        self.model = mujoco.MjModel.from_xml_path(str(folder / "scene_pd.xml"))
        self.data = mujoco.MjData(self.model)
        names = card["scene"]
        # Left legs come first, unlike in the card.
        joints = [motor["joint"] for motor in card["motors"]]
        self.motor_names = sorted(joints, key=lambda name: (name[0], name[1] != "L"))
        where = [joints.index(name) for name in self.motor_names]
        self.motors = [self.model.actuator(names["actuators"][i]).id for i in where]
        self.joints = [self.model.joint(names["joints"][i]) for i in where]
        self.board, self.trunk = names["board_body"], names["robot_joint"]
        for i in where:
            self.data.joint(names["joints"][i]).qpos = card["motors"][i]["default"]
        self.data.joint(self.trunk).qpos = [*start, 0.3, 1, 0, 0, 0]
        self.data.eq_active[self.model.equality(names["weld"]).id] = 0  # the board is free
        self.pictures: deque[dict[str, Any]] = deque(maxlen=2)
        self._look()

    def time(self) -> float:
        """Return the robot's clock, s."""
        return float(self.data.time)

    def state(self) -> dict[str, np.ndarray]:
        """Return the newest values of the motors and of the inertial measurement unit."""
        return {
            "quaternion": self.data.body(self.trunk).xquat,
            "gyroscope": self.data.sensor("base_ang_vel").data,
            "angles": np.array([self.data.qpos[joint.qposadr[0]] for joint in self.joints]),
            "speeds": np.array([self.data.qvel[joint.dofadr[0]] for joint in self.joints]),
        }

    def picture(self) -> dict[str, Any]:
        """Return the last pose of the board that the camera has found; it comes a control step late."""
        return self.pictures[0]

    def send(self, angles: np.ndarray, kp: np.ndarray, kd: np.ndarray) -> None:
        """Give the motors new targets."""
        for motor, target, stiffness, damping in zip(self.motors, angles, kp, kd):
            self.model.actuator_gainprm[motor, 0] = stiffness
            self.model.actuator_biasprm[motor, 1:3] = -stiffness, -damping
            self.data.ctrl[motor] = target

    def wait(self, seconds: float) -> None:
        """Let the robot move for a while; then the camera takes a picture."""
        for _ in range(round(seconds / self.model.opt.timestep)):
            mujoco.mj_step(self.model, self.data)
        self._look()

    def damp(self) -> None:
        """Take the stiffness from the motors."""
        self.model.actuator_gainprm[self.motors, 0] = 0.0
        self.model.actuator_biasprm[self.motors, 1] = 0.0

    def _look(self) -> None:
        mujoco.mj_forward(self.model, self.data)
        trunk, board = self.data.body(self.trunk), self.data.body(self.board)
        to_trunk = trunk.xmat.reshape(3, 3).T
        pos, rot = to_trunk @ (board.xpos - trunk.xpos), to_trunk @ board.xmat.reshape(3, 3)
        seen = {"board_pos": self.camera_rot.T @ (pos - self.camera_pos), "board_rot": self.camera_rot.T @ rot}
        self.pictures.append(seen | {"time": self.time()})
