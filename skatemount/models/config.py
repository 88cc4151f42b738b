"""Settings of the networks."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from typing import Any

from skatemount.utils.bounds import check_bounds, each, number
from skatemount.utils.classes import ClassRegistry
from skatemount.utils.errors import ConfigError, brief
from skatemount.utils.formatting import format_count

ACTIVATIONS = ("elu", "relu", "tanh", "silu")
MAX_LAYERS = 32
MAX_WEIGHTS = 2**27
"""Largest number of weights between the hidden layers of a network, half a gigabyte."""

NETWORKS = ClassRegistry(
    "network",
    {"mlp": "skatemount.models.actor_critic:ActorCritic"},
    methods=("learners", "prepare", "observe", "reset_statistics", "limit_std", "actor_in", "transforms", "state_dict"),
    base="skatemount.models.base.Networks",
    given=("config", "observation", "privileged", "actions", "reflections"),
)
"""Actors and critics by ``network.kind``."""


@dataclass
class NetworkConfig:
    """Settings of actor and critic.

    Attributes:
        kind: Class of the networks: ``mlp`` (`skatemount.models.actor_critic.ActorCritic`), the name of a plugin's, or
            ``module:Class`` of your own.
        params: Parameters of your own class, by name.
        actor: Sizes of the actor's hidden layers.
        critic: Sizes of the critic's hidden layers.
        activation: ``elu``, ``relu``, ``tanh`` or ``silu``.
        init_std: Initial standard deviation of the actions, in units of the action scale.
        min_std: Lower bound of the standard deviation.
        max_std: Upper bound of the standard deviation.
        normalize: Normalize observations by their running mean and deviation, inside the networks.
        symmetric: Build the networks so that the mirror image of a state gives the mirror image of the action, and
            the same value.
    """

    kind: str
    params: dict[str, Any]
    actor: list[int] = field(metadata=each(1, 16_384))
    critic: list[int] = field(metadata=each(1, 16_384))
    activation: str
    init_std: float = field(metadata=number(0, 100, above=True))
    min_std: float = field(metadata=number(0, 100, above=True))
    max_std: float = field(metadata=number(0, 100, above=True))
    normalize: bool
    symmetric: bool

    def validate(self, where: str = "network") -> None:
        """Raise `ConfigError` if a setting cannot be used."""
        NETWORKS.check_choice(self.kind, self.params, where)
        check_bounds(self, where)
        for name in ("actor", "critic"):
            sizes = getattr(self, name)
            if not 1 <= len(sizes) <= MAX_LAYERS:
                raise ConfigError(f"{where}.{name}={brief(sizes)} must be 1 to {MAX_LAYERS} layer sizes")
            if self.symmetric and any(size % 2 for size in sizes):
                raise ConfigError(f"{where}.{name}={sizes} must be even numbers with {where}.symmetric=true")
            weights = sum(a * b for a, b in itertools.pairwise(sizes))
            if weights > MAX_WEIGHTS:
                raise ConfigError(
                    f"{where}.{name}={sizes} has {format_count(weights)} weights between its layers; at most "
                    f"{format_count(MAX_WEIGHTS)} are possible"
                )
        if self.activation not in ACTIVATIONS:
            raise ConfigError(f"{where}.activation={self.activation} must be one of {', '.join(ACTIVATIONS)}")
        if not 0 < self.min_std <= self.init_std <= self.max_std:
            raise ConfigError(
                f"{where}: min_std={self.min_std}, init_std={self.init_std}, max_std={self.max_std} must satisfy "
                "0 < min_std <= init_std <= max_std"
            )
