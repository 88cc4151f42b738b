"""The observation table: terms with their noise, scale and history, concatenated into one vector."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from skatemount.envs.config.terms import ObservationTerm
from skatemount.envs.memory import term_name
from skatemount.envs.mirror import KINDS, mirror_map
from skatemount.envs.robots.layout import JointLayout
from skatemount.envs.sampling import coarse_noise
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.terms import AnyTerm, Registry, TaskContext, memory_of
from skatemount.utils.errors import ConfigError

Size = Callable[[JointLayout, dict[str, Any]], int]
"""A function that computes a number of values from the robot's layout and the parameters of a term."""


@dataclass(frozen=True)
class TermLayout:
    """The size of an observation term and its left-right symmetry.

    Attributes:
        size: Number of values, or a function that computes it from the robot's layout and the term's parameters.
        mirror: A key of `skatemount.envs.mirror.KINDS`; None if the term has no left-right mirror image.
    """

    size: int | Size
    mirror: str | None

    def count(self, layout: JointLayout, params: dict[str, Any]) -> int:
        """Return the number of values for a robot and the given parameters."""
        return self.size if isinstance(self.size, int) else self.size(layout, params)


OBSERVATIONS = Registry("observation", columns=lambda term, layout, params: term.count(layout, params))


def observation(size: int | Size, mirror: str | None) -> Callable[[AnyTerm], AnyTerm]:
    """Return a decorator that registers an observation term.

    Args:
        size: See `TermLayout`.
        mirror: See `TermLayout`.

    Raises:
        ConfigError: There is no such kind of mirror image, or the term's name is taken.
    """
    register: Callable[[AnyTerm], AnyTerm] = OBSERVATIONS.register(TermLayout(size, mirror))

    def add(function: AnyTerm) -> AnyTerm:
        if mirror is not None and mirror not in KINDS:
            known = ", ".join(KINDS)
            where = f"observation {term_name(function)} of {function.__module__}"
            raise ConfigError(f"{where}: mirror={mirror!r} must be one of {known}, or None for no mirror image")
        return register(function)

    return add


@dataclass(frozen=True)
class _Block:
    """The part of the vector that belongs to one term: ``frames`` times ``size`` values."""

    name: str
    term: ObservationTerm
    size: int
    frames: int
    mirror: str | None


class ObservationTable:
    """Observation terms in one vector.

    A term with a history occupies several frames: its values of the last control steps, oldest first. Each frame keeps
    the noise that was drawn for it.

    Args:
        terms: Settings of the terms by name, in the order of the vector.
        context: Constants of the task.
        where: Name of the table in the configuration, for messages.
        history_length: Number of frames of the terms that do not set their own.

    Attributes:
        size: Number of values in the vector.
        names: Names of the terms, in order.
        memory: Those of the terms that have a memory.

    Raises:
        ConfigError: The table is empty, a term is unknown, or a setting has a value that cannot be used.
    """

    def __init__(
        self,
        terms: dict[str, ObservationTerm],
        context: TaskContext,
        where: str = "observation.policy",
        history_length: int = 1,
    ):
        if not terms:
            raise ConfigError(f"{where} is empty; it must have at least one of {', '.join(OBSERVATIONS.names())}")
        self._context = context
        self._where = where
        self._functions = [OBSERVATIONS.bind(name, term.params, where) for name, term in terms.items()]
        self.memory = memory_of(self._functions)
        self._blocks = []
        for name, term in terms.items():
            own = term.history_length
            frames, setting = (history_length, where.rpartition(".")[0]) if own is None else (own, f"{where}.{name}")
            if frames < 1:
                raise ConfigError(f"{setting}.history_length={frames} must be 1 or more; 1 is the present alone")
            if not 0 <= term.noise < math.inf:
                raise ConfigError(f"{where}.{name}.noise={term.noise} must be 0 or more, and finite")
            if not math.isfinite(term.scale):
                raise ConfigError(f"{where}.{name}.scale={term.scale} must be finite")
            if term.clip is not None and not term.clip > 0:
                raise ConfigError(f"{where}.{name}.clip={term.clip} must be above 0, or null for none")
            attributes = OBSERVATIONS.attributes(name)
            self._blocks.append(
                _Block(name, term, attributes.count(context.layout, term.params), frames, attributes.mirror)
            )
        self.names = list(terms)
        self.size = sum(block.size * block.frames for block in self._blocks)
        self._remembers = any(block.frames > 1 for block in self._blocks)
        self._first, self._next = self._sources()

        def column(value: Callable[[ObservationTerm], float]) -> Tensor:
            return torch.cat([torch.full((block.size,), value(block.term)) for block in self._blocks])

        self._scale, self._noise = column(lambda t: t.scale), column(lambda t: t.noise)
        self._clip = column(lambda t: torch.inf if t.clip is None else t.clip)
        self._noisy = bool((self._noise > 0).any())
        self._clipped = bool(self._clip.isfinite().any())

    def _sources(self) -> tuple[Tensor, Tensor]:
        """Compute the indices from which `__call__` gathers the vector.

        Returns:
            ``[size]`` int64 into the frame, for the first step of an episode, and ``[size]`` int64 into the previous
            vector followed by the frame, for later steps.
        """
        first, following, start, column = [], [], 0, 0
        for block in self._blocks:
            frame, end = torch.arange(column, column + block.size), start + block.size * block.frames
            first.append(frame.repeat(block.frames))
            following += [torch.arange(start + block.size, end), self.size + frame]
            start, column = end, column + block.size
        return torch.cat(first), torch.cat(following)

    def __call__(
        self,
        sim: SimState,
        episode: EpisodeState,
        generator: torch.Generator | Tensor | None = None,
        previous: Tensor | None = None,
    ) -> Tensor:
        """Compute the vector of every world.

        Args:
            sim: The state.
            episode: The episodes.
            generator: Source of the noise, or ``[N, F]`` noise from -1 to 1 that is drawn already; no noise if None.
            previous: ``[N, size]``, the vector of the previous control step. None at the start of an episode, where the
                first frame fills the whole history.

        Returns:
            ``[N, size]`` float32.
        """
        frame = self._frame(sim, episode, generator)
        if not self._remembers:
            return frame
        if previous is None:
            return frame[:, self._first]
        return torch.cat((previous, frame), 1)[:, self._next]

    def _frame(self, sim: SimState, episode: EpisodeState, generator: torch.Generator | Tensor | None) -> Tensor:
        """Compute the present frame, ``[N, F]``: the terms with noise, then clip, then scale."""
        values = torch.cat([f(sim, episode, self._context) for f in self._functions], -1)
        if generator is not None and self._noisy:
            noise = generator if isinstance(generator, Tensor) else coarse_noise(values.shape, generator)
            values = torch.addcmul(values, noise, self._noise)
        if self._clipped:
            values = values.clamp(-self._clip, self._clip)
        return values * self._scale

    def names_at(self, columns: Tensor) -> list[str]:
        """Return the names of the terms that some entries of the vector belong to.

        Args:
            columns: ``[size]`` bool.
        """
        parts = columns.split([block.size * block.frames for block in self._blocks])
        return [block.name for block, part in zip(self._blocks, parts) if part.any()]

    def layout(self) -> list[dict[str, Any]]:
        """Describe the vector for a policy's card.

        Returns:
            The name, size and scale of each term in order, and its number of frames if it has several.
        """
        parts = []
        for block in self._blocks:
            part = {"name": block.name, "size": block.size * block.frames, "scale": round(float(block.term.scale), 6)}
            parts.append(part | ({"history_length": block.frames} if block.frames > 1 else {}))
        return parts

    def mirror(self) -> tuple[Tensor, Tensor]:
        """Return the left-right mirror image as a permutation and signs: ``mirrored = x[:, permutation] * signs``.

        Returns:
            The permutation, ``[size]`` int64, and the signs, ``[size]`` float32.

        Raises:
            ConfigError: A term has no mirror image.
        """
        permutations, signs, start = [], [], 0
        for block in self._blocks:
            if block.mirror is None:
                raise ConfigError(
                    f"{self._where}.{block.name} has no left-right mirror image, which network.symmetric=true needs; "
                    "remove the term or set network.symmetric=false"
                )
            permutation, sign = self._mirror_map(block)
            for _ in range(block.frames):
                permutations.append(permutation + start)
                signs.append(sign)
                start += block.size
        return torch.cat(permutations), torch.cat(signs)

    def _mirror_map(self, block: _Block) -> tuple[Tensor, Tensor]:
        """Return permutation and signs of one frame of a term.

        Raises:
            ConfigError: The term was registered with a kind of mirror image that is of another size.
        """
        where = f"{self._where}.{block.name} of {OBSERVATIONS.module(block.name)}: mirror={block.mirror!r}"
        assert block.mirror is not None
        permutation, sign = mirror_map(block.mirror, block.size, self._context.layout)
        if not len(permutation) == len(sign) == block.size:
            raise ConfigError(f"{where}: is no mirror image of a term of size {block.size}")
        return permutation, sign
