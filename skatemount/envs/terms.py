"""Terms: named functions for rewards, observations and terminations, switched on by tables in YAML.

A term is a function ``(sim, episode, context, **parameters)`` that is registered under its own name, or a class with
memory (`skatemount.envs.memory.TermWithMemory`). A table in the configuration maps names of terms to their parameters.
An unknown name or parameter is an error that lists the known ones.
"""

from __future__ import annotations

import difflib
import inspect
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, TypeVar, cast, get_args, get_origin, get_type_hints

import numpy as np
import torch
from torch import Tensor

from skatemount.envs.config.terms import PARAMETERS
from skatemount.envs.legs import Legs
from skatemount.envs.memory import BoundMemoryTerm, check_class, term_name
from skatemount.envs.robots.layout import JointLayout
from skatemount.envs.scene import Scene
from skatemount.envs.state import SimState
from skatemount.utils.bounds import Bounds
from skatemount.utils.errors import ConfigError

TermFunction = Callable[..., Tensor]
AnyTerm = TypeVar("AnyTerm", bound=Callable[..., Any])
"""A term as it is registered: a function that returns a tensor, or a class whose objects do."""


@dataclass(frozen=True)
class TaskContext:
    """Constants of a task that terms need.

    Attributes:
        control_step: Seconds between two actions.
        layout: Order of the joints, feet and bodies, and how many of them there are.
        default_pose: ``[J]`` joint angles of the stance, rad.
        soft_limits: ``[J, 2]`` lower and upper bound of the middle 90 % of the joint ranges, rad.
        deck_half: Half length and half width of the deck, m.
        deck_height: Height of the deck's top above the board's floor at rest, m.
        wheels_half: Half wheelbase and half track of the board, m.
        foot_radius: Radius of a foot, m.
        stance_height: Height of the trunk's center above the soles in the default pose, m.
        episode_steps: Control steps of a full episode.
        steering: Steering length of the board, m, and largest curvature of its path, 1/m.
    """

    control_step: float
    layout: JointLayout
    default_pose: Tensor
    soft_limits: Tensor
    deck_half: tuple[float, float]
    deck_height: float
    wheels_half: tuple[float, float]
    foot_radius: float
    stance_height: float
    episode_steps: int
    steering: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def of(cls, scene: Scene, episode_length: float) -> TaskContext:
        """Collect the constants of a scene.

        Args:
            scene: The scene.
            episode_length: Length of a full episode, s.

        Returns:
            The constants, with tensors on torch's default device.
        """
        robot, board = scene.robot, scene.board.config
        ranges = torch.as_tensor(robot.joint_range, dtype=torch.float32)
        middle, half = ranges.mean(1), (ranges[:, 1] - ranges[:, 0]) / 2
        default = torch.as_tensor(np.asarray(robot.default_pose), dtype=torch.float32)
        feet = Legs(robot.spec).feet(default)
        step = scene.solver.control_step
        kind = ContextOfBoards if scene.boards_vary else cls
        return kind(
            control_step=step,
            layout=robot.layout,
            default_pose=default,
            soft_limits=torch.stack((middle - 0.9 * half, middle + 0.9 * half), 1),
            deck_half=(board.deck_length / 2, board.deck_width / 2),
            deck_height=board.deck_height,
            wheels_half=(board.wheelbase / 2, board.track / 2),
            foot_radius=robot.kinematics.foot_radius,
            stance_height=float(robot.kinematics.foot_radius - feet[:, 2].mean()),
            episode_steps=max(1, round(episode_length / step)),
            steering=(board.steering_length, board.max_curvature),
        )

    def deck_half_of(self, sim: SimState) -> tuple[float, float] | tuple[Tensor, Tensor]:
        """Return half length and half width of the deck, m: two numbers, or two ``[N, 1]`` if boards vary."""
        if (sizes := sim.board_sizes) is None:
            return cast(tuple[float, float], vars(self)["deck_half"])
        return sizes[:, 0:1], sizes[:, 1:2]

    def deck_height_of(self, sim: SimState) -> float | Tensor:
        """Return the height of the deck's top above the floor at rest, m: a number, or ``[N, 1]`` if boards vary."""
        return cast(float, vars(self)["deck_height"]) if sim.board_sizes is None else sim.board_sizes[:, 2:3]

    def steering_of(self, sim: SimState) -> tuple[float, float] | tuple[Tensor, Tensor]:
        """Return steering length, m, and largest curvature, 1/m: two numbers, or two ``[N]`` if boards vary.

        See `skatemount.envs.config.board.SkateboardConfig.max_curvature`.
        """
        if (sizes := sim.board_sizes) is None:
            return cast(tuple[float, float], vars(self)["steering"])
        return sizes[:, 5], sizes[:, 6]

    def wheels_scale_of(self, sim: SimState) -> tuple[float, float] | tuple[Tensor, Tensor]:
        """Return wheelbase and track as shares of those of the settings' board: 1, or ``[N, 1]`` if boards vary."""
        if (sizes := sim.board_sizes) is None:
            return 1.0, 1.0
        return sizes[:, 3:4] / self.wheels_half[0], sizes[:, 4:5] / self.wheels_half[1]


class ContextOfBoards(TaskContext):
    """Constants of a task in which boards vary from world to world: it refuses to give a size that all boards have."""

    def __getattribute__(self, name: str) -> Any:
        """Return an attribute.

        Raises:
            ConfigError: It is a size of the board.
        """
        if name in ("deck_half", "deck_height", "steering"):
            raise ConfigError(
                f"context.{name} is of one board, but boards=varied gives every world its own; a term must use "
                f"context.{name}_of(sim)"
            )
        return super().__getattribute__(name)


Columns = Callable[[Any, JointLayout, dict[str, Any]], int]


class Registry:
    """Named term functions of one kind.

    Args:
        kind: ``reward``, ``observation`` or ``termination``, for messages.
        flags: True if the terms return bool, False if they return floats.
        columns: Takes a term's properties, the robot's layout and the term's parameters, and returns the number of
            values in a world; None if the terms return one value without a dimension of its own, ``[N]``.
    """

    def __init__(self, kind: str, flags: bool = False, columns: Columns | None = None):
        self.kind = kind
        self._flags, self._columns = flags, columns
        self._functions: dict[str, Callable[..., Any]] = {}
        self._attributes: dict[str, Any] = {}

    def register(self, attributes: Any = None) -> Callable[[AnyTerm], AnyTerm]:
        """Return a decorator that registers a function, or a class with memory, under its own name.

        Args:
            attributes: Properties of the term, which `attributes` returns.

        Raises:
            ConfigError: The name is taken.
        """

        def add(function: AnyTerm) -> AnyTerm:
            key = term_name(function)
            if key in self._functions:
                raise ConfigError(
                    f"{self.kind} term {key!r} is registered twice, by {self._functions[key].__module__} and by "
                    f"{function.__module__}"
                )
            self._functions[key] = function
            self._attributes[key] = attributes
            return function

        return add

    def names(self) -> list[str]:
        """Return every known name, sorted."""
        return sorted(self._functions)

    def attributes(self, name: str) -> Any:
        """Return the properties that a term was registered with."""
        return self._attributes[name]

    def description(self, name: str) -> str:
        """Return the first line of a term's docstring; "" without one."""
        lines = (inspect.getdoc(self._functions[name]) or "").splitlines()
        return lines[0] if lines else ""

    def module(self, name: str) -> str:
        """Return the name of the module that registered a term."""
        return self._functions[name].__module__

    def definition(self, name: str) -> Callable[..., Any]:
        """Return the function or class of a term."""
        return self._functions[name]

    def parameters(self, name: str) -> dict[str, Any]:
        """Return the default values of a term's own parameters by name."""
        function = self._functions[name]
        return {each.name: each.default for each in _own_parameters(function)}

    def snapshot(self) -> tuple[dict[str, Callable[..., Any]], dict[str, Any]]:
        """Return the present terms, for `restore`."""
        return dict(self._functions), dict(self._attributes)

    def restore(self, saved: tuple[dict[str, Callable[..., Any]], dict[str, Any]]) -> None:
        """Go back to the terms of a snapshot."""
        self._functions, self._attributes = dict(saved[0]), dict(saved[1])

    def check(self) -> None:
        """Raise `ConfigError` for a term whose signature cannot be used."""
        for name, function in self._functions.items():
            _parameter_types(f"{self.kind} {name} of {function.__module__}", function)

    def bind(self, name: str, params: dict[str, Any], table: str | None = None) -> TermFunction:
        """Return a term's function with its parameters set.

        Args:
            name: Name of the term.
            params: Parameters by name.
            table: Name of the table in the configuration, for messages; the kind of the terms if None.

        Returns:
            A function of state, episode and context.

        Raises:
            ConfigError: The term or a parameter is unknown, or a parameter has a value that cannot be used.
        """
        where = f"{table or self.kind}.{name}"
        if name not in self._functions:
            close = difflib.get_close_matches(name, self._functions, n=3)
            hint = f"did you mean {' or '.join(close)}?" if close else "one of your own needs plugins=[<module>]"
            raise ConfigError(f"{where} is not a known {self.kind}; {hint} (skatemount list {self.kind}s has all)")
        function = self._functions[name]
        types = _parameter_types(f"{where} of {function.__module__}", function)
        known = list(types)
        for key in params:
            if key not in known:
                names = ", ".join(known) or "none"
                raise ConfigError(f"{where}.params.{key} is not a parameter; known: {names}")
        own = function.__module__.startswith("skatemount.")
        for key, value in params.items():
            _check_parameter(f"{where}.params.{key}", value, types[key], PARAMETERS.get(key) if own else None)
        bound: TermFunction
        if isinstance(function, type):
            bound = BoundMemoryTerm(function, params, where)
        else:
            bound = partial(function, **params) if params else function
        if own:
            return bound
        columns, attributes = self._columns, self._attributes[name]

        def size(layout: JointLayout) -> tuple[int, ...]:
            return () if columns is None else (columns(attributes, layout, params),)

        return _CheckedTerm(bound, f"{where} of {function.__module__}", size, self._flags)


@dataclass(frozen=True)
class _CheckedTerm:
    """A term of a plugin, whose results are checked.

    Attributes:
        function: The term with its parameters.
        where: Name of the term and its module, for messages.
        size: Takes the robot's layout and returns the shape of the result behind the dimension of the worlds.
        flags: True if the result must be bool, False if it must be of the state's type, float32.
    """

    function: TermFunction
    where: str
    size: Callable[[JointLayout], tuple[int, ...]]
    flags: bool

    def __call__(self, sim: SimState, episode: Any, context: TaskContext) -> Tensor:
        """Return the term's result.

        Raises:
            ConfigError: It is no tensor, or one of the wrong shape or type.
        """
        value = self.function(sim, episode, context)
        shape = (sim.base_pos.shape[0], *self.size(context.layout))
        kind = torch.bool if self.flags else sim.base_pos.dtype
        if not isinstance(value, Tensor):
            found = type(value).__name__
        else:
            if value.shape == shape and value.dtype == kind:
                return value
            found = f"{_written(value.dtype)} of shape {list(value.shape)}"
        raise ConfigError(f"{self.where} returned {found}; it must return {_written(kind)} of shape {list(shape)}")


def _written(kind: torch.dtype) -> str:
    return str(kind).removeprefix("torch.")


def memory_of(terms: Sequence[TermFunction]) -> list[BoundMemoryTerm]:
    """Return those of bound terms that have a memory."""
    plain = [term.function if isinstance(term, _CheckedTerm) else term for term in terms]
    return [term for term in plain if isinstance(term, BoundMemoryTerm)]


def _own_parameters(function: Callable[..., Any]) -> list[inspect.Parameter]:
    """Return the parameters of a function behind state, episode and context, or of a class behind the worlds."""
    first = 2 if isinstance(function, type) else 3
    return list(inspect.signature(function).parameters.values())[first:]


def _parameter_types(where: str, function: Callable[..., Any]) -> dict[str, Any]:
    """Return the types of a term's own parameters by name.

    Raises:
        ConfigError: The function is no term: it does not take state, episode and context, or a parameter has no type
            or no default. Or the class lacks a method of a term with memory.
    """
    if isinstance(function, type):
        check_class(where, function)
    elif (names := list(inspect.signature(function).parameters))[:3] != ["sim", "episode", "context"]:
        found = ", ".join(names)
        raise ConfigError(f"{where} takes ({found}); a term takes (sim, episode, context) and then its parameters")
    own = _own_parameters(function)
    try:
        types = get_type_hints(getattr(function, "__init__") if isinstance(function, type) else function)  # noqa: B009
    except NameError as error:
        raise ConfigError(f"{where}: {error} in its annotations; import it where the term can see it") from error
    for each in own:
        if each.name not in types or each.default is each.empty:
            raise ConfigError(f"{where}: parameter {each.name} needs a type and a default, {each.name}: float = 1.0")
    return {each.name: types[each.name] for each in own}


def _check_parameter(where: str, value: Any, kind: Any, bounds: Bounds | None) -> None:
    if get_origin(kind) is Literal:
        if value not in get_args(kind):
            raise ConfigError(f"{where}={value} must be {' or '.join(get_args(kind))}")
        return
    allowed = get_args(kind) or (kind,)
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if float in allowed and number:
        if not math.isfinite(value):
            raise ConfigError(f"{where}={value} must be a finite number")
        if bounds is not None:
            bounds.check(where, value)
        if where.endswith((".scale", ".sigma")) and value <= 0:
            raise ConfigError(f"{where}={value} must be above 0, because the term divides by it")
        return
    if isinstance(value, bool) != (bool in allowed) or not isinstance(value, allowed):
        names = " or ".join("null" if t is type(None) else t.__name__ for t in allowed)
        raise ConfigError(f"{where}={value} must be of type {names}")
    if bounds is not None and number:
        bounds.check(where, value)


def upright(sim: SimState) -> Tensor:
    """Compute how upright the trunk is: clamp(-g_z, 0, 0.7) / 0.7, with g_z of gravity's direction in the trunk frame.

    The paper's code multiplies most of its reward terms by this factor.

    Args:
        sim: The state.

    Returns:
        ``[N]`` from 0 to 1; 1 within about 45 degrees of upright.
    """
    return (-sim.gravity[:, 2]).clamp(0.0, 0.7) / 0.7
