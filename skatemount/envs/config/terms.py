"""Settings of one row in a table of terms."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass
class ObservationTerm:
    """One row of the observation table.

    Attributes:
        scale: Factor applied last.
        noise: Half width of the uniform noise added first, in the term's own unit.
        clip: Bound on the absolute value, applied after the noise; none if null.
        history_length: Frames of it in the vector, the present one included, oldest first; null takes the table's.
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
        weight: 0 or more. Per second, or, for an event, each time it happens. Whether the term is added or
            subtracted is a property of the term.
        upright: Multiply by how upright the trunk is, as the paper's code does on most of its terms.
        clip: Largest value of the term before it is weighed; none if null.
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
        enabled: Whether it counts.
        params: Parameters of the term's function.
    """

    enabled: bool = True
    params: dict[str, Any] = field(default_factory=dict)
