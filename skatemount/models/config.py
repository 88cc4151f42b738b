"""Settings of the networks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from skatemount.utils.classes import ClassRegistry
from skatemount.utils.errors import ConfigError

ACTIVATIONS = ("elu", "relu", "tanh", "silu")

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
    actor: list[int]
    critic: list[int]
    activation: str
    init_std: float
    min_std: float
    max_std: float
    normalize: bool
    symmetric: bool

    def validate(self, where: str = "network") -> None:
        """Raise `ConfigError` if a setting cannot be used."""
        NETWORKS.check_choice(self.kind, self.params, where)
        for name in ("actor", "critic"):
            sizes = getattr(self, name)
            if not sizes or min(sizes) < 1:
                raise ConfigError(f"{where}.{name}={sizes} must be a list of layer sizes, each at least 1")
            if self.symmetric and any(size % 2 for size in sizes):
                raise ConfigError(f"{where}.{name}={sizes} must be even numbers with {where}.symmetric=true")
        if self.activation not in ACTIVATIONS:
            raise ConfigError(f"{where}.activation={self.activation} must be one of {', '.join(ACTIVATIONS)}")
        if not 0 < self.min_std <= self.init_std <= self.max_std:
            raise ConfigError(
                f"{where}: min_std={self.min_std}, init_std={self.init_std}, max_std={self.max_std} must satisfy "
                "0 < min_std <= init_std <= max_std"
            )
