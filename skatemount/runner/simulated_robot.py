"""`SimulatedRobot`: a shipped episode behind the interface of a real robot, to try a program without hardware."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from skatemount.runner.folder import PolicyFolder, RunnerError
from skatemount.runner.simulation import Outcome, SimulatedWorld


class SimulatedRobot:
    """A robot in MuJoCo, see `skatemount.runner.hardware.Robot`. Each `write` is a control step.

    Args:
        folder: The exported policy.
        suite: Name of a suite in the folder.
        episode: Number of the start state.

    Attributes:
        outcome: What the last step led to; None before the first one.
        stopped: True after `stop`.
    """

    def __init__(self, folder: PolicyFolder, suite: str, episode: int = 0):
        if suite not in folder.suites:
            raise RunnerError(f"suite={suite}: the folder has {', '.join(folder.suites) or 'none'}")
        variants = folder.suites[suite]["variants"]
        self.world = SimulatedWorld(folder, variants[episode % len(variants)])
        self._measured = self.world.begin(episode // len(variants))
        self.outcome: Outcome | None = None
        self.stopped = False

    def read(self) -> Mapping[str, Any]:
        """Return what the simulated sensors show."""
        return self._measured

    def write(self, targets: np.ndarray, kp: np.ndarray, kd: np.ndarray) -> None:
        """Simulate a control step; the gains are those of the scene's motors.

        Raises:
            RunnerError: The robot is stopped.
        """
        if self.stopped:
            raise RunnerError("the robot is stopped; make a new SimulatedRobot")
        self.outcome = self.world.step(targets, np.zeros(3))
        self._measured = self.outcome.measured

    def stop(self) -> None:
        """Let no further control step happen."""
        self.stopped = True
