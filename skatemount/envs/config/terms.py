"""Settings of the rows in the tables of terms."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass
class ObservationTerm:
    """One row of the observation table.

    Attributes:
        scale: Factor that is applied last.
        noise: Half width of the uniform noise that is added first, in the unit of the term.
        clip: Bound on the absolute value, applied after the noise; no bound if null.
        history_length: Number of frames in the vector, the present one included, oldest first; that of the table if
            null.
        params: Parameters of the term's function.
    """

    scale: float = 1.0
    noise: float = 0.0
    clip: float | None = None
    history_length: int | None = None
    params: dict[str, Any] = field(default_factory=dict)


@dataclass
class RewardTerm:
    """One row of the reward table.

    Attributes:
        weight: Size of the weight, 0 or more: per second, or for each occurrence of an event. The term itself is a
            reward, which is added, or a penalty, which is subtracted.
        upright: True if the term is multiplied by `skatemount.envs.terms.upright`, as most terms of the paper's code
            are.
        clip: Largest value of the term before it is weighted; no bound if null.
        params: Parameters of the term's function.
    """

    weight: float = 0.0
    upright: bool = False
    clip: float | None = None
    params: dict[str, Any] = field(default_factory=dict)


@dataclass
class TerminationTerm:
    """One row of the termination table.

    Attributes:
        enabled: True if the term can end an episode.
        params: Parameters of the term's function.
    """

    enabled: bool = True
    params: dict[str, Any] = field(default_factory=dict)
