"""An exported policy on a robot: what the drivers measure becomes what the policy's card names, and targets go back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np


class MyRobot:
    """The robot behind three methods, see `skatemount.runner.hardware.Robot`. It needs numpy alone.

    Args:
        bus: The robot's drivers. `stand_in.Bus` has the same methods and simulates them.
        card: Card of the exported policy.
    """

    def __init__(self, bus: Any, card: Mapping[str, Any]):
        self.bus = bus
        # The card names the joints in the policy's order; the drivers have one of their own.
        self.order = [bus.motor_names.index(motor["joint"]) for motor in card["motors"]]

    def read(self) -> Mapping[str, Any]:
        """Return the measurements that the card names, in its units and frames."""
        state, picture = self.bus.state(), self.bus.picture()
        w, x, y, z = state["quaternion"]
        return {
            # The third row of the rotation from trunk to world, downward.
            "gravity": -np.array([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]),
            "base_ang_vel": state["gyroscope"],
            "joint_pos": state["angles"][self.order],
            "joint_vel": state["speeds"][self.order],
            # From the frame of the camera to that of the trunk.
            "board_pos_base": self.bus.camera_pos + self.bus.camera_rot @ picture["board_pos"],
            "board_rot_base": self.bus.camera_rot @ picture["board_rot"],
            "board_age": self.bus.time() - picture["time"],
        }

    def write(self, targets: np.ndarray, kp: np.ndarray, kd: np.ndarray) -> None:
        """Send joint targets and gains to the motors."""
        sent = np.empty((3, len(self.order)))
        sent[:, self.order] = targets, kp, kd
        self.bus.send(*sent)

    def stop(self) -> None:
        """Let the motors only damp."""
        self.bus.damp()
