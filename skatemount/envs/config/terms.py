"""Settings of the rows in the tables of terms."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from skatemount.utils.bounds import Bounds, number

_SIZE = "give the size, as the term itself is added or subtracted"
PARAMETERS: dict[str, Bounds] = {
    name: bounds
    for names, declared in (
        (("degrees",), number(0, 180, "degrees", above=True)),
        (("metres",), number(0, 1000, "m")),
        (("gate",), number(0, 1000, "m", above=True)),
        (("limit",), number(0, 1000, "m/s", above=True)),
        (("when_mounted",), number(0, 1e6)),
        (("scale", "sigma"), number(0, 1e6, above=True)),
        (("points",), number(1, 1000)),
        (("threshold",), number(0, 1e6, "N")),
        (("ramp",), number(0, 3600, "s")),
        (("height",), number(0, 10, "m")),
        (("target",), number(-10, 10, "m")),
    )
    for bounds in declared.values()
    for name in names
}
"""Bounds of the parameters of the package's own terms by name; a name means the same in every term."""


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

    scale: float = field(default=1.0, metadata=number(-1e6, 1e6))
    noise: float = field(default=0.0, metadata=number(0, 1e6))
    clip: float | None = field(default=None, metadata=number(0, 1e9, above=True))
    history_length: int | None = field(default=None, metadata=number(1, 100))
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

    weight: float = field(default=0.0, metadata=number(0, 1e6, why=_SIZE))
    upright: bool = False
    clip: float | None = field(default=None, metadata=number(0, 1e9, above=True))
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
