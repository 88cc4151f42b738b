"""Episodes of MountBench in plain MuJoCo, from the start states that an export ships."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from skatemount.runner.controller import Controller
from skatemount.runner.folder import PolicyFolder, RunnerError

_FAILED = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)


@dataclass(frozen=True)
class Outcome:
    """Result of a control step.

    Attributes:
        measured: What the robot's sensors show, by name.
        terminations: ``[T]`` bool, the conditions that end the episode; the last one is that the physics failed.
        truncated: True if the time limit ended the episode.
        succeeded: True if it was truncated and meets the task's criterion.
        mounted: True if the robot is mounted now.
    """

    measured: dict[str, np.ndarray]
    terminations: np.ndarray
    truncated: bool
    succeeded: bool
    mounted: bool

    @property
    def done(self) -> bool:
        """True if the episode is over."""
        return bool(self.truncated or self.terminations.any())


class SimulatedWorld:
    """One world of a variant of a suite.

    Args:
        folder: The exported policy.
        variant: The variant's part of the card, one of ``card["suites"][name]["variants"]``.

    Attributes:
        episodes: Number of start states.
        model: MuJoCo's model, with the fields of the episode's own world.
        data: MuJoCo's data.
        step_number: Control steps since the start.

    Raises:
        RunnerError: This version of MuJoCo cannot open the scene.
    """

    def __init__(self, folder: PolicyFolder, variant: dict[str, Any]):
        file = folder.path / variant["scene"]
        try:
            self.model = mujoco.MjModel.from_xml_path(str(file))
        except ValueError as error:
            wanted = folder.card["versions"].get("mujoco", "a newer one")
            raise RunnerError(
                f"{file}: MuJoCo {mujoco.__version__} cannot open it ({' '.join(str(error).split())[:120]}); "
                f"it was exported with {wanted}"
            ) from error
        self.data = mujoco.MjData(self.model)
        self.starts = folder.arrays(variant["starts"])
        self.episodes = len(self.starts["start"])
        self._world = folder.graph(variant["world"])
        self._substeps = int(folder.card["control"]["substeps"])
        names, model = folder.card["scene"], self.model
        self._motors = [model.actuator(name).id for name in names["actuators"]]
        self._joint_dofs = [int(model.joint(name).dofadr[0]) for name in names["joints"]]
        self._wheel_dofs = [int(model.joint(name).dofadr[0]) for name in names["wheel_joints"]]
        self._base_dof = int(model.joint(names["robot_joint"]).dofadr[0])
        self._board = model.body(names["board_body"]).id
        self._weld = model.equality(names["weld"]).id
        self._floor = int(model.body(names["floor"]).mocapid[0])
        self._errors = int(self._world.shapes["errors"][1]) if "errors" in self._world.shapes else 0

    @property
    def error_size(self) -> int:
        """Number of sensor errors that are drawn in each control step; 0 for none."""
        return self._errors

    def begin(self, row: int) -> dict[str, np.ndarray]:
        """Begin an episode.

        Args:
            row: Number of its start state.

        Returns:
            What the robot's sensors show first, by name.
        """
        model, data, starts = self.model, self.data, self.starts
        mujoco.mj_resetData(model, data)
        for name, values in starts.items():
            part, _, field = name.partition(".")
            if part == "model":
                getattr(model, field)[...] = values[row]
            elif part == "state" and field == "time":
                data.time = float(values[row])
            elif part == "state":
                getattr(data, field)[...] = values[row]
        mujoco.mj_forward(model, data)
        # The solver of the first step starts where that of the exported world does.
        data.qacc_warmstart[:] = starts["state.qacc_warmstart"][row]
        self._memory = {n: v[row : row + 1] for n, v in starts.items() if n.startswith("memory.")}
        self._pushes = {}
        if "push.episode" in starts:
            mine = starts["push.episode"] == row
            self._pushes = dict(zip(starts["push.step"][mine].tolist(), starts["push.velocity"][mine], strict=True))
        self._commands = starts["command"][row] if "command" in starts else None
        self.step_number = 0
        # Loads on the board follow from the start state; the memory is already that of the start.
        self._loads = self._computed(np.zeros(3), None)
        measured = {n.removeprefix("sensed."): v[row] for n, v in starts.items() if n.startswith("sensed.")}
        return self._with_command(measured)

    def step(self, targets: np.ndarray, command: np.ndarray, errors: np.ndarray | None = None) -> Outcome:
        """Simulate a control step.

        Args:
            targets: ``[J]`` joint targets, rad.
            command: ``[3]``, the velocity command that the robot followed.
            errors: ``[error_size]`` from -1 to 1, errors of the sensors as shares of their sizes; none if None.
        """
        model, data, loads = self.model, self.data, self._loads
        if (velocity := self._pushes.get(self.step_number)) is not None:
            data.qvel[self._base_dof : self._base_dof + 3] += velocity
        if "wheel_friction" in loads:
            model.dof_frictionloss[self._wheel_dofs] = loads["wheel_friction"][0]
        if "board_force" in loads:
            data.xfrc_applied[self._board, :3] = loads["board_force"][0]
        offset = loads["target_offset"][0] if "target_offset" in loads else np.float32(0)
        data.ctrl[self._motors] = np.asarray(targets, np.float32) + offset
        for _ in range(self._substeps):
            mujoco.mj_step(model, data)
        # Positions and velocities of the end of the step; forces stay those of its last physics step.
        mujoco.mj_step1(model, data)
        self.step_number += 1
        failed = any(data.warning[each].number for each in _FAILED) or not np.isfinite(data.qpos).all()
        results = self._loads = self._computed(command, errors)
        self._memory = {name: results[f"next.{name.removeprefix('memory.')}"] for name in self._memory}
        measured = {n.removeprefix("sensed."): v[0] for n, v in results.items() if n.startswith("sensed.")}
        terminations = np.append(results["terminations"][0], failed)
        truncated = bool(results["truncated"][0]) and not failed
        return Outcome(
            self._with_command(measured),
            terminations,
            truncated,
            truncated and bool(results["succeeded"][0]),
            bool(results["mounted"][0]),
        )

    def _with_command(self, measured: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return measured if self._commands is None else {**measured, "command": self._commands[self.step_number]}

    def _computed(self, command: np.ndarray, errors: np.ndarray | None) -> dict[str, np.ndarray]:
        """Return the outputs of the world's graph for the present state."""
        data = self.data
        values = {
            "sensordata": _single(data.sensordata)[None],
            "joint_acc": _single(data.qacc[self._joint_dofs])[None],
            "ground_height": _single(data.mocap_pos[self._floor, 2:]),
            "board_fixed": np.array([bool(data.eq_active[self._weld])]),
            "followed": _single(command)[None],
            "errors": np.zeros((1, self._errors), np.float32) if errors is None else _single(errors)[None],
            **self._memory,
        }
        return self._world(values)


def _single(values: np.ndarray) -> np.ndarray:
    return np.asarray(values, np.float32)


@dataclass(frozen=True)
class EpisodeResult:
    """Result of an episode.

    Attributes:
        episode: Its number in the suite.
        variant: Name of the suite's variant; "" without variants.
        success: True if it succeeded.
        ended_by: The termination that ended it, or the task's failure at the time limit.
        duration: Its length, s.
        start: Initial x, y (m) and yaw (rad) of the trunk in the board's frame.
        board_fixed: True if the board was welded to the world.
    """

    episode: int
    variant: str
    success: bool
    ended_by: str
    duration: float
    start: tuple[float, float, float]
    board_fixed: bool


def run_episode(
    controller: Controller, world: SimulatedWorld, variant: dict[str, Any], row: int, random: np.random.Generator
) -> tuple[bool, str, int]:
    """Run an episode.

    The noise of sensors and observation is drawn from the same distributions as in an evaluation. Everything else
    that is random comes with the start state.

    Args:
        controller: The policy's controller for the variant.
        world: The variant's world.
        variant: Its part of the card.
        row: Number of the start state.
        random: Source of the noise. In each control step it gives the noise of the observation, then the errors of the
            sensors.

    Returns:
        Whether it succeeded, what ended it, and the number of control steps.
    """

    def noise(size: int) -> np.ndarray | None:
        return random.uniform(-1, 1, size).astype(np.float32) if size else None

    measured = world.begin(row)
    controller.begin()
    steps, over = 0, False
    while not over:
        steps += 1
        targets = controller.step(measured, noise(controller.noise_size))
        outcome = world.step(targets, controller.command, noise(world.error_size))
        measured, over = outcome.measured, outcome.done
    if outcome.terminations.any():
        return False, variant["ends"][1 + int(outcome.terminations.argmax())], steps
    return outcome.succeeded, variant["ends"][0], steps
