"""The parts of a training's state, each with `state_dict` and `load_state_dict`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import torch
from torch import Tensor

from skatemount.utils.devices import rng_state, set_rng_state
from skatemount.utils.errors import ConfigError

if TYPE_CHECKING:
    from skatemount.training.callbacks import Callback


class Stateful(Protocol):
    """A part of the training state."""

    def state_dict(self) -> dict[str, Any]:
        """Return nested dicts with string keys of tensors and plain values; see `save_state`."""
        ...

    def load_state_dict(self, state: dict[str, Any], /) -> Any:
        """Restore what `state_dict` returned."""
        ...


class Generators:
    """The states of random generators, torch's own of a device included.

    Args:
        device: The device whose own generator is saved, under the name ``torch``.
        generators: Further generators by name.
    """

    def __init__(self, device: torch.device | None = None, **generators: torch.Generator) -> None:
        self._device = device
        self._generators = generators

    def state_dict(self) -> dict[str, Tensor]:
        """Return the generators' states, byte tensors by name."""
        states = {name: generator.get_state() for name, generator in self._generators.items()}
        return states if self._device is None else states | {"torch": rng_state(self._device)}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restore what `state_dict` returned."""
        for name, generator in self._generators.items():
            generator.set_state(state[name])
        if self._device is not None:
            set_rng_state(state["torch"], self._device)


class Attributes:
    """Numbers that an object keeps as attributes, 0 or more.

    Args:
        owner: The object.
        names: The attributes.
    """

    def __init__(self, owner: object, *names: str) -> None:
        self._owner = owner
        self._names = names

    def state_dict(self) -> dict[str, Any]:
        """Return the attributes by name."""
        return {name: getattr(self._owner, name) for name in self._names}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` returned."""
        for name in self._names:
            now, saved = getattr(self._owner, name), state[name]
            if isinstance(saved, bool) or not isinstance(saved, float | int if isinstance(now, float) else type(now)):
                raise TypeError(f"{name}={saved!r} is no {type(now).__name__}")
            if isinstance(saved, float | int) and not 0 <= saved < 2**62:
                raise ValueError(f"{name}={saved!r} must be 0 or more, and less than 2**62")
        for name in self._names:
            setattr(self._owner, name, state[name])


class CallbackStates:
    """The states of those callbacks that have any, by the names of their classes.

    Args:
        callbacks: The callbacks of a training.
    """

    def __init__(self, callbacks: Sequence[Callback]) -> None:
        self._named: dict[str, Callback] = {}
        for callback in callbacks:
            name = type(callback).__name__
            same = sum(known.partition("#")[0] == name for known in self._named)
            self._named[f"{name}#{same + 1}" if same else name] = callback

    def state_dict(self) -> dict[str, Any]:
        """Return the states by name."""
        states = {name: callback.state_dict() for name, callback in self._named.items()}
        return {name: state for name, state in states.items() if state}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the states of the callbacks that are there; a callback that was not there before starts fresh."""
        for name, callback in self._named.items():
            if name in state:
                callback.load_state_dict(state[name])


ADDED = ("guard",)
"""Parts that older checkpoints lack; they start fresh."""


def save_parts(parts: Mapping[str, Stateful]) -> dict[str, Any]:
    """Return the states of named parts, for `save_checkpoint`."""
    return {name: dict(part.state_dict()) for name, part in parts.items()}


def load_parts(parts: Mapping[str, Stateful], state: Mapping[str, Any], where: str) -> None:
    """Restore named parts.

    Args:
        parts: The parts.
        state: The states that `save_parts` returned.
        where: The checkpoint's name in messages.

    Raises:
        ConfigError: The state lacks a part; nothing is restored then. Or a part does not fit, because the run's
            settings or its state were changed.
    """
    parts = {name: part for name, part in parts.items() if name in state or name not in ADDED}
    if missing := [name for name in parts if name not in state]:
        raise ConfigError(
            f"{where}: its training state has no part {missing[0]!r}, only {', '.join(state)}; it cannot be resumed "
            "here, but init_from takes its policy"
        )
    for name, part in parts.items():
        try:
            part.load_state_dict(state[name])
        except (AttributeError, IndexError, KeyError, RuntimeError, TypeError, ValueError) as error:
            reason = " ".join(str(error).split())[:300]
            raise ConfigError(
                f"{where}: part {name!r} of its training state does not fit the run's settings, or was changed "
                f"({type(error).__name__}: {reason})"
            ) from error


def copied(state: Any) -> Any:
    """Return a copy of nested dicts whose tensors share no memory with the original."""
    if isinstance(state, Mapping):
        return {name: copied(value) for name, value in state.items()}
    return state.clone() if isinstance(state, Tensor) else state
