"""`Controller`: from measurements to joint targets, once in each control step."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from skatemount.runner.folder import PolicyFolder, RunnerError

_INTERNAL = ("begins", "noise")


class Controller:
    """A policy with the memory that its observation needs, for one robot.

    Args:
        folder: The exported policy.
        observing: File of the graph of the observation; suites with another board or command have their own.

    Attributes:
        measurements: Names of what `step` needs, in the units of the card.
        noise_size: Number of values of the noise that the policy was trained with; 0 for none.
        observation: The last observation, ``[D]``.
        action: The last action, ``[J]``.
        command: The last velocity command, ``[3]``: forward, left (m/s) and turn left (rad/s).
    """

    def __init__(self, folder: PolicyFolder, observing: str = "observe.onnx"):
        self._observe, self._policy = folder.graph(observing), folder.graph("policy.onnx")
        shapes = self._observe.shapes
        self.measurements = [name for name in shapes if not name.startswith("memory.") and name not in _INTERNAL]
        self.noise_size = int(shapes["noise"][1]) if "noise" in shapes else 0
        self.begin()

    def begin(self) -> None:
        """Forget the past: the next step is the first one of an episode."""
        names = [name for name in self._observe.shapes if name.startswith("memory.")]
        self._memory = {name: self._observe.zeros(name) for name in names}
        self._begins = True
        self.observation = self.action = self.command = np.zeros(0, np.float32)

    def step(self, measured: Mapping[str, Any], noise: np.ndarray | None = None) -> np.ndarray:
        """Return the joint targets that follow from new measurements.

        Args:
            measured: Values by name, at least those in `measurements`.
            noise: ``[noise_size]`` from -1 to 1, noise of the observation as in the policy's training; none if None.

        Returns:
            ``[J]`` rad.

        Raises:
            RunnerError: A measurement is missing, has another shape, or is not finite.
        """
        observe = self._observe
        values = {name: self._checked(name, measured) for name in self.measurements}
        values |= self._memory
        values["begins"] = np.array([[self._begins]])
        if self.noise_size:
            values["noise"] = observe.zeros("noise") if noise is None else np.float32(noise).reshape(1, -1)
        seen = observe(values)
        acted = self._policy({"observation": seen["observation"]})
        known = {"memory.action": acted["action"]}
        known |= {f"memory.{name[5:]}": value for name, value in seen.items() if name.startswith("next.")}
        self._memory = {name: known[name] for name in self._memory}
        self._begins = False
        self.observation, self.action, self.command = seen["observation"][0], acted["action"][0], seen["commanded"][0]
        return np.asarray(acted["targets"][0])

    def _checked(self, name: str, measured: Mapping[str, Any]) -> np.ndarray:
        shape, kind = self._observe.shapes[name], self._observe.kinds[name]
        if name not in measured:
            raise RunnerError(f"measurement {name} is missing; the policy needs {', '.join(self.measurements)}")
        value: np.ndarray = np.asarray(measured[name], kind)
        if value.size != int(np.prod(shape)):
            raise RunnerError(f"measurement {name} has shape {list(value.shape)}; it must be {shape[1:]}")
        if not np.isfinite(value).all():
            raise RunnerError(f"measurement {name}={value.ravel().tolist()} must be finite")
        return value.reshape(shape)
