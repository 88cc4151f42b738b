"""Terms: rewards, observations and terminations as named functions that a YAML table switches on.

A term is a function ``(sim, episode, context, **parameters)`` registered under a name. A table in the configuration
maps names to parameters; an unknown name or parameter is an error that lists the known ones.
"""

from __future__ import annotations

import difflib
import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, get_args, get_type_hints

import numpy as np
import torch
from torch import Tensor

from skatemount.envs.legs import Legs
from skatemount.envs.scene import Scene
from skatemount.envs.state import SimState
from skatemount.utils.errors import ConfigError

TermFunction = Callable[..., Tensor]


@dataclass(frozen=True)
class TaskContext:
    """Constants of a task that terms need.

    Attributes:
        control_step: Seconds between two actions.
        default_pose: ``[12]`` joint angles of the stance, rad.
        soft_limits: ``[12, 2]`` middle 90 % of the joint ranges, rad.
        deck_half: Half length and half width of the deck, m.
        deck_height: Height of the deck's top above the board's floor at rest, m.
        foot_radius: m.
        stance_height: Height of the trunk's centre above the soles in the default pose, m.
        episode_steps: Control steps of a full episode.
    """

    control_step: float
    default_pose: Tensor
    soft_limits: Tensor
    deck_half: tuple[float, float]
    deck_height: float
    foot_radius: float
    stance_height: float
    episode_steps: int

    @classmethod
    def of(cls, scene: Scene, episode_length: float) -> TaskContext:
        """Constants of a scene.

        Args:
            scene: The scene.
            episode_length: Seconds.
        """
        robot, board = scene.robot, scene.board.config
        ranges = torch.as_tensor(robot.joint_range, dtype=torch.float32)
        middle, half = ranges.mean(1), (ranges[:, 1] - ranges[:, 0]) / 2
        default = torch.as_tensor(np.asarray(robot.default_pose), dtype=torch.float32)
        feet = Legs(robot.kinematics).feet(default)
        step = scene.solver.control_step
        return cls(
            control_step=step,
            default_pose=default,
            soft_limits=torch.stack((middle - 0.9 * half, middle + 0.9 * half), 1),
            deck_half=(board.deck_length / 2, board.deck_width / 2),
            deck_height=board.deck_height,
            foot_radius=robot.kinematics.foot_radius,
            stance_height=float(robot.kinematics.foot_radius - feet[:, 2].mean()),
            episode_steps=max(1, round(episode_length / step)),
        )


class Registry:
    """Named term functions of one kind.

    Args:
        kind: What the terms are, for messages: ``reward``, ``observation`` or ``termination``.
    """

    def __init__(self, kind: str):
        self.kind = kind
        self._functions: dict[str, TermFunction] = {}
        self._attributes: dict[str, Any] = {}

    def register(self, attributes: Any = None) -> Callable[[TermFunction], TermFunction]:
        """Decorator that adds a function under its own name.

        Args:
            attributes: What else is known of the term; see `attributes`.

        Raises:
            ValueError: The name is taken.
        """

        def add(function: TermFunction) -> TermFunction:
            key = function.__name__
            if key in self._functions:
                raise ValueError(f"{self.kind} term {key!r} is registered twice")
            self._functions[key] = function
            self._attributes[key] = attributes
            return function

        return add

    def names(self) -> list[str]:
        """Every known name, sorted."""
        return sorted(self._functions)

    def function(self, name: str) -> TermFunction:
        """The function registered under a name; `ConfigError` if there is none."""
        if name not in self._functions:
            close = difflib.get_close_matches(name, self._functions, n=1)
            hint = f" (did you mean {close[0]}?)" if close else ""
            raise ConfigError(f"{self.kind}.{name} is not a known {self.kind}{hint}; known: {', '.join(self.names())}")
        return self._functions[name]

    def attributes(self, name: str) -> Any:
        """What was registered with a term."""
        self.function(name)
        return self._attributes[name]

    def bind(self, name: str, params: dict[str, Any]) -> TermFunction:
        """The term's function with its parameters set.

        Args:
            name: The term.
            params: Parameters by name.

        Raises:
            ConfigError: An unknown term or parameter.
        """
        function = self.function(name)
        known = list(inspect.signature(function).parameters)[3:]
        for key in params:
            if key not in known:
                names = ", ".join(known) or "none"
                raise ConfigError(f"{self.kind}.{name}.params.{key} is not a parameter; known: {names}")
        types = get_type_hints(function)
        for key, value in params.items():
            _check_parameter(f"{self.kind}.{name}.params.{key}", value, types[key])
        return partial(function, **params) if params else function


def _check_parameter(where: str, value: Any, kind: Any) -> None:
    allowed = get_args(kind) or (kind,)
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if float in allowed and number:
        if not math.isfinite(value):
            raise ConfigError(f"{where}={value} must be a finite number")
        if where.endswith((".scale", ".sigma")) and value <= 0:
            raise ConfigError(f"{where}={value} must be above 0: it is divided by")
        return
    if isinstance(value, bool) != (bool in allowed) or not isinstance(value, allowed):
        names = " or ".join("null" if t is type(None) else t.__name__ for t in allowed)
        raise ConfigError(f"{where}={value} must be of type {names}")
    if where.endswith(".points") and value < 1:
        raise ConfigError(f"{where}={value} must be at least 1")


def upright(sim: SimState) -> Tensor:
    """How upright the trunk is, ``[N]`` in 0..1; 1 within about 45 degrees of upright.

    u = clamp(-g_z, 0, 0.7) / 0.7, the factor of the paper's code on most of its terms.
    """
    return (-sim.gravity[:, 2]).clamp(0.0, 0.7) / 0.7
