"""Worlds whose physics fails: they are counted, copied on request, and start states that fail at once are refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from torch import Tensor

from skatemount.envs.config.task import TaskConfig
from skatemount.envs.physics.base import Physics
from skatemount.utils.errors import ConfigError, brief

SHARE = 0.25
"""Share of the new episodes that may fail in their first control step."""

LEAST = 8
"""Number of such failures below which the share says nothing."""

FORGET = 1024
"""New episodes, at least, after which older ones count half."""

_NAMED = (
    "height",
    "roll",
    "pitch",
    "lin_vel",
    "ang_vel",
    "joint_pos",
    "joint_vel",
    "step_height",
    "board_speed",
    "board_lean",
    "force",
    "torque",
)


@dataclass
class DivergedWorld:
    """A world whose physics failed in a control step, as it was before that step.

    Attributes:
        world: Number of the world.
        model: Its model, with its randomized fields.
        nominal: The model of the scene.
        state: Its full state by the names of MuJoCo's ``MjData``; ``ctrl`` has the targets of the step.
        action: ``[J]``, the action of the step.
        targets: ``[J]`` joint position targets, rad.
        episode_step: Control steps of its episode before that step.
        substeps: Physics steps in a control step.
    """

    world: int
    model: mujoco.MjModel
    nominal: mujoco.MjModel
    state: dict[str, np.ndarray]
    action: np.ndarray
    targets: np.ndarray
    episode_step: int
    substeps: int


class Divergence:
    """Watches the worlds of an environment for physics that fails.

    Args:
        physics: The worlds.
        config: Settings of the task, for messages.
    """

    def __init__(self, physics: Physics, config: TaskConfig) -> None:
        self._physics, self._config = physics, config
        self._watcher: Callable[[DivergedWorld], bool] | None = None
        self._before: Any = None
        self._new: list[Tensor] = []
        self._failing: set[int] = set()
        self._count = 0
        self._begun = self._at_once = 0.0

    def watch(self, watcher: Callable[[DivergedWorld], bool] | None) -> None:
        """Copy every world that fails from now on, which takes a copy of all states before each control step.

        Args:
            watcher: Gets the copies, and returns whether it wants more of them; None to copy no more.
        """
        self._watcher, self._before = watcher, None

    def begin(self, rows: Tensor) -> None:
        """Note new episodes.

        Args:
            rows: ``[K]`` int64, their worlds.
        """
        self._new.append(rows)

    def before_step(self) -> None:
        """Keep what a copy needs, if somebody watches."""
        if self._watcher is not None:
            self._before = self._physics.raw_state()

    def after_step(self, failed: Tensor, action: Tensor, targets: Tensor, steps: Tensor, substeps: int) -> None:
        """Count the worlds that failed in a control step.

        Args:
            failed: ``[K]`` int64, worlds that have failed since their last reset.
            action: ``[N, J]`` of the step.
            targets: ``[N, J]`` rad.
            steps: ``[N]`` control steps of the episodes, this one included.
            substeps: Physics steps in a control step.

        Raises:
            ConfigError: A large share of the new episodes failed in their first control step.
        """
        new, self._new = self._new, []
        self._begun += sum(len(rows) for rows in new)
        worlds = failed.tolist()
        if not worlds:
            self._failing.clear()
            return
        begun = {world for rows in new for world in rows.tolist()}
        fresh = [world for world in worlds if world in begun or world not in self._failing]
        self._failing = set(worlds)
        self._count += len(fresh)
        for world in fresh:
            if self._watcher is None or self._before is None:
                break
            model, state = self._physics.world(world, self._before)
            values = np.asarray(targets[world].cpu(), np.float64)
            state["ctrl"][self._physics.index.actuators] = values
            copied = np.asarray(action[world].cpu(), np.float64)
            step = int(steps[world]) - 1
            wanted = self._watcher(
                DivergedWorld(world, model, self._physics.model, state, copied, values, step, substeps)
            )
            if not wanted:
                self.watch(None)
        self._at_once += sum(world in begun for world in fresh)
        if self._at_once >= LEAST and self._at_once >= SHARE * self._begun:
            raise ConfigError(self._message())
        if self._begun > max(FORGET, 4 * self._physics.num_worlds):
            self._begun, self._at_once = self._begun / 2, self._at_once / 2

    def pop(self) -> dict[str, float]:
        """Return the number of worlds that have failed since the last call, as a metric."""
        count, self._count = self._count, 0
        return {"Train/diverged_worlds": float(count)}

    def _message(self) -> str:
        start = self._config.start
        values = {name: getattr(start, name) for name in _NAMED}
        chosen = ", ".join(f"start.{name}={value}" for name, value in values.items() if value and any(value))
        return (
            f"start states diverge at once: the physics of {self._at_once:.0f} of {self._begun:.0f} new episodes "
            f"({self._at_once / self._begun:.0%}) failed in their first control step; they are drawn from "
            f"{brief(chosen or 'zeros')}; smaller values, softer robot.kp={self._config.robot.kp:g}, or a "
            f"shorter physics.timestep={self._config.physics.timestep:g} may help"
        )
