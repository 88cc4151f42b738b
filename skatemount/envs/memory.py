"""Terms with memory: classes that keep something of each world's episode between control steps."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import torch
from tensordict import is_tensor_collection
from torch import Tensor

from skatemount.envs.state import EpisodeState, SimState
from skatemount.utils.errors import ConfigError

if TYPE_CHECKING:
    from skatemount.envs.terms import TaskContext

_METHODS = {
    "__init__": ["context", "num_worlds"],
    "reset": ["rows"],
    "__call__": ["sim", "episode", "context"],
    "state_dict": [],
    "load_state_dict": ["state"],
}
"""Methods of a term with memory, and the parameters that each begins with."""


class TermWithMemory:
    """Base of terms with memory, whose tensors of the class's attributes are the memory.

    A term with memory is a class with these methods; this base has the last two, so that a subclass has to define only
    the others:

    - ``__init__(self, context, num_worlds, **parameters)`` makes the memory, for worlds whose episodes begin.
    - ``reset(self, rows)`` forgets some worlds, ``[K]`` int64.
    - ``__call__(self, sim, episode, context)`` returns the term's values and updates the memory. It is called once in
      each control step, and a term of an observation also at the start of an episode.
    - ``state_dict()`` returns the memory, tensors by name whose first dimension is the worlds.
    - ``load_state_dict(state)`` restores it.

    Each tensor must be an attribute of its own. One in a list or dict is an error, because it would not be saved.
    """

    def state_dict(self) -> dict[str, Tensor]:
        """Return the tensors of the term by the names of their attributes."""
        return {name: value for name, value in vars(self).items() if isinstance(value, Tensor)}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restore a memory that `state_dict` returned.

        Raises:
            KeyError: A tensor is missing.
        """
        for name, value in self.state_dict().items():
            # A copy, because a step in inference mode makes tensors that cannot be written to outside of it.
            setattr(self, name, state[name].to(value.device, copy=True))


def term_name(term: Callable[..., Any]) -> str:
    """Return the name of a term in the tables: that of a function, or ``feet_air_time`` of a class `FeetAirTime`."""
    name = term.__name__
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower() if isinstance(term, type) else name


def check_class(where: str, kind: type) -> None:
    """Check that a class has the methods of a term with memory.

    Args:
        where: Name of the term, for messages.
        kind: The class.

    Raises:
        ConfigError: A method is missing or takes other parameters.
    """
    for name, begin in _METHODS.items():
        written = f"{name}({', '.join(begin)}{', ...' if name == '__init__' else ''})"
        # `getattr` would find the method by which a class makes its objects.
        found = next((vars(base)[name] for base in kind.__mro__[:-1] if name in vars(base)), None)
        if found is None:
            raise ConfigError(f"{where} has no {written}; see skatemount.envs.memory.TermWithMemory")
        taken = list(inspect.signature(found).parameters)[1:]
        if taken[: len(begin)] != begin or (name != "__init__" and len(taken) > len(begin)):
            raise ConfigError(f"{where}: its method is {name}({', '.join(taken)}); it must be {written}")


def _hides_tensors(value: Any) -> bool:
    """Return whether a value is a list, dict or other collection that holds tensors, however deep."""
    if isinstance(value, Tensor | str | bytes):
        return False
    if is_tensor_collection(value):
        return True
    inner = value.values() if isinstance(value, Mapping) else value if isinstance(value, Collection) else ()
    return any(isinstance(each, Tensor) or _hides_tensors(each) for each in inner)


class BoundMemoryTerm:
    """A class of a term with its parameters set, and its object for the worlds of one environment.

    Args:
        kind: The class.
        params: Parameters by name.
        where: Name of the term, for messages and saved states.
    """

    def __init__(self, kind: Callable[..., Any], params: dict[str, Any], where: str):
        self.where = where
        self.keeps_value = False
        self._kind, self._params = kind, params
        self._term: Any = None
        self._num_worlds = 0
        self._value: Tensor | None = None

    def allocate(self, context: TaskContext, num_worlds: int) -> None:
        """Make the memory for worlds whose episodes begin; an earlier one is dropped.

        Raises:
            ConfigError: The memory cannot be saved; see `state_dict`.
        """
        self._term, self._num_worlds, self._value = self._kind(context, num_worlds, **self._params), num_worlds, None
        self.state_dict()

    def next_step(self) -> None:
        """Forget the value of the last step, so that the next call computes a new one."""
        self._value = None

    def __call__(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
        """Return the term's values, ``[N, ...]``, and update the memory.

        Once the term is part of an `Mdp`, calls within one step return the same values.
        """
        if self._value is not None:
            return self._value
        if self._term is None:
            self.allocate(context, sim.base_pos.shape[0])
        value: Tensor = self._term(sim, episode, context)
        if self.keeps_value:
            self._value = value
        return value

    def reset(self, rows: Tensor) -> None:
        """Forget some worlds, ``[K]`` int64."""
        self._term.reset(rows)

    def observe_start(self, sim: SimState, episode: EpisodeState, context: TaskContext, rows: Tensor) -> None:
        """Compute the values at the start of some worlds' episodes, which the next call returns.

        Args:
            sim: ``[K]`` states of those worlds.
            episode: ``[K]`` episodes.
            context: Constants of the task.
            rows: ``[K]`` int64, the worlds.

        Raises:
            ConfigError: The memory cannot be saved; see `state_dict`.
        """
        some = self._kind(context, len(rows), **self._params)
        self._value = some(sim, episode, context)
        memory = self.state_dict()
        for name, value in self._memory_of(some, len(rows)).items():
            memory[name][rows] = value
        self._term.load_state_dict(memory)

    def state_dict(self) -> dict[str, Tensor]:
        """Return the memory, tensors by name.

        Raises:
            ConfigError: The first dimension of a tensor is not the worlds; or a list or another attribute of a
                `TermWithMemory` holds tensors, which would be lost.
        """
        return self._memory_of(self._term, self._num_worlds)

    def _memory_of(self, term: Any, num_worlds: int) -> dict[str, Tensor]:
        if getattr(type(term), "state_dict", None) is TermWithMemory.state_dict:
            for name, value in vars(term).items():
                if _hides_tensors(value):
                    raise ConfigError(
                        f"{self.where}: its attribute {name} is a {type(value).__name__} that holds tensors, which a "
                        "saved training would not have; make each a tensor of its own, or write state_dict and "
                        "load_state_dict"
                    )
        memory = dict(term.state_dict())
        for name, value in memory.items():
            if not isinstance(value, Tensor) or value.dim() == 0 or len(value) != num_worlds:
                found = f"shape {list(value.shape)}" if isinstance(value, Tensor) else f"type {type(value).__name__}"
                raise ConfigError(
                    f"{self.where}: {name!r} of its state_dict has {found} for {num_worlds} worlds; it must be a "
                    "tensor whose first dimension is the worlds"
                )
        return memory

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restore a memory that `state_dict` returned.

        Raises:
            ConfigError: It is the memory of another number of worlds or of another term.
        """
        present = self.state_dict()
        shapes, saved = ({name: list(value.shape) for name, value in each.items()} for each in (present, state))
        if shapes != saved:
            raise ConfigError(f"{self.where}: its saved memory has shapes {saved}; they must be {shapes}")
        self._term.load_state_dict(state)
        self._value = None


class TermMemory:
    """The memory of all terms of one environment, as a part of its state.

    Args:
        terms: The terms that have one.
        observing: Those that belong to an observation, which is computed at the start of an episode as well.
        context: Constants of the task.
        device: Device of the states.
    """

    def __init__(
        self,
        terms: Sequence[BoundMemoryTerm],
        observing: Sequence[BoundMemoryTerm],
        context: TaskContext,
        device: torch.device,
    ):
        self._terms, self._observing, self._context, self._device = list(terms), list(observing), context, device
        for term in self._terms:
            term.keeps_value = True

    def allocate(self, num_worlds: int) -> None:
        """Make the memory for a number of worlds whose episodes begin."""
        with self._device:
            for term in self._terms:
                term.allocate(self._context, num_worlds)

    def next_step(self) -> None:
        """Let every term compute new values from now on."""
        for term in self._terms:
            term.next_step()

    def begin(self, sim: SimState, episode: EpisodeState, rows: Tensor | None) -> None:
        """Begin new episodes.

        Args:
            sim: ``[K]`` start states.
            episode: ``[K]`` episodes at their start.
            rows: ``[K]`` int64, the worlds of the states. None if they are all worlds that there are.
        """
        if not self._terms:
            return
        if rows is None:
            rows = torch.arange(len(episode.step), device=self._device)
            self.allocate(len(rows))
        with self._device:
            for term in self._terms:
                term.next_step()
                term.reset(rows)
            for term in self._observing:
                term.observe_start(sim, episode, self._context, rows)

    def state_dict(self) -> dict[str, dict[str, Tensor]]:
        """Return the memory of every term, by the name of its row in the settings."""
        return {term.where: term.state_dict() for term in self._terms}

    def load_state_dict(self, state: dict[str, dict[str, Tensor]]) -> None:
        """Restore what `state_dict` returned, for the same number of worlds.

        Raises:
            ConfigError: The state lacks a term, or has another number of worlds.
        """
        for term in self._terms:
            if term.where not in state:
                raise ConfigError(f"{term.where}: the saved state has no memory of it, only of {list(state)}")
            term.load_state_dict(state[term.where])
