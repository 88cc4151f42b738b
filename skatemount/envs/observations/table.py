"""The observation table: which terms are seen, how well and for how long, as one vector."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from skatemount.envs.config.terms import ObservationTerm
from skatemount.envs.mirror import mirror_map
from skatemount.envs.sampling import coarse_noise
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.terms import Registry, TaskContext
from skatemount.utils.errors import ConfigError


@dataclass(frozen=True)
class Layout:
    """How an observation term is laid out.

    Attributes:
        size: Number of values, or a function of the term's parameters.
        mirror: Kind of `skatemount.envs.mirror.mirror_map`, or none if the term has no left-right mirror image.
    """

    size: int | Callable[[dict[str, Any]], int]
    mirror: str | None

    def count(self, params: dict[str, Any]) -> int:
        """Number of values with the given parameters."""
        return self.size if isinstance(self.size, int) else self.size(params)


OBSERVATIONS = Registry("observation")


def observation(size: int | Callable[[dict[str, Any]], int], mirror: str | None) -> Callable:
    """Register a term; the arguments are those of `Layout`."""
    return OBSERVATIONS.register(Layout(size, mirror))


@dataclass(frozen=True)
class _Block:
    """A term's place in the vector: ``frames`` times ``size`` values."""

    name: str
    term: ObservationTerm
    size: int
    frames: int
    mirror: str | None


class ObservationTable:
    """Observation terms in one vector.

    A term with a history holds what was seen of it in the last control steps, one after the other, each with the noise
    that it was seen with then.

    Args:
        terms: The table, in order.
        context: Constants of the task.
        where: Name of the table in the configuration, for messages.
        history_length: Frames of the terms that do not say how many.

    Attributes:
        size: Values in the vector.
        names: Terms in order.

    Raises:
        ConfigError: No term, an unknown one, or a value that cannot be used.
    """

    def __init__(
        self,
        terms: dict[str, ObservationTerm],
        context: TaskContext,
        where: str = "observation.policy",
        history_length: int = 1,
    ):
        if not terms:
            raise ConfigError(f"{where} is empty: it must name at least one of {', '.join(OBSERVATIONS.names())}")
        self._context = context
        self._functions = [OBSERVATIONS.bind(name, term.params) for name, term in terms.items()]
        self._blocks = []
        for name, term in terms.items():
            own = term.history_length
            frames, setting = (history_length, where.rpartition(".")[0]) if own is None else (own, f"{where}.{name}")
            if frames < 1:
                raise ConfigError(f"{setting}.history_length={frames} must be 1, for the present alone, or more")
            if not 0 <= term.noise < math.inf:
                raise ConfigError(f"{where}.{name}.noise={term.noise} must be 0 or more, and finite")
            if not math.isfinite(term.scale):
                raise ConfigError(f"{where}.{name}.scale={term.scale} must be finite")
            if term.clip is not None and not term.clip > 0:
                raise ConfigError(f"{where}.{name}.clip={term.clip} must be above 0, or null for none")
            layout = OBSERVATIONS.attributes(name)
            self._blocks.append(_Block(name, term, layout.count(term.params), frames, layout.mirror))
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
        """Where each value comes from: in a frame, or in the last vector followed by a frame."""
        first, following, start, seen = [], [], 0, 0
        for block in self._blocks:
            frame, end = torch.arange(seen, seen + block.size), start + block.size * block.frames
            first.append(frame.repeat(block.frames))
            following += [torch.arange(start + block.size, end), self.size + frame]
            start, seen = end, seen + block.size
        return torch.cat(first), torch.cat(following)

    def __call__(
        self,
        sim: SimState,
        episode: EpisodeState,
        generator: torch.Generator | None = None,
        previous: Tensor | None = None,
    ) -> Tensor:
        """The vector of every world.

        Args:
            sim: The state.
            episode: The episodes.
            generator: Source of the noise; without one there is none.
            previous: ``[N, size]``, the vector one control step ago; none at the start of an episode, where the first
                frame stands for those before it.

        Returns:
            ``[N, size]`` float32.
        """
        frame = self._frame(sim, episode, generator)
        if not self._remembers:
            return frame
        if previous is None:
            return frame[:, self._first]
        return torch.cat((previous, frame), 1)[:, self._next]

    def _frame(self, sim: SimState, episode: EpisodeState, generator: torch.Generator | None) -> Tensor:
        """What is seen now: noise, then clip, then scale."""
        values = torch.cat([f(sim, episode, self._context) for f in self._functions], -1)
        if generator is not None and self._noisy:
            values = torch.addcmul(values, coarse_noise(values.shape, generator), self._noise)
        if self._clipped:
            values = values.clamp(-self._clip, self._clip)
        return values * self._scale

    def layout(self) -> list[dict[str, Any]]:
        """The contract of the vector: each term's name, size and scale in order, and its frames if it has several."""
        parts = []
        for block in self._blocks:
            part = {"name": block.name, "size": block.size * block.frames, "scale": round(float(block.term.scale), 6)}
            parts.append(part | ({"history_length": block.frames} if block.frames > 1 else {}))
        return parts

    def mirror(self) -> tuple[Tensor, Tensor]:
        """The left-right mirror image as a permutation and signs: ``mirrored = x[:, permutation] * signs``.

        Returns:
            ``[size]`` int64 and ``[size]`` float32.

        Raises:
            ConfigError: A term has no mirror image.
        """
        permutations, signs, start = [], [], 0
        for block in self._blocks:
            if block.mirror is None:
                raise ConfigError(
                    f"observation term {block.name} has no left-right mirror image: choose another or "
                    "network.symmetric=false"
                )
            permutation, sign = mirror_map(block.mirror, block.size)
            for _ in range(block.frames):
                permutations.append(permutation + start)
                signs.append(sign)
                start += block.size
        return torch.cat(permutations), torch.cat(signs)
