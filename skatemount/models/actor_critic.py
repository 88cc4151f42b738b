"""Actor and critic: the actor reads ``observation``, the critic also reads ``privileged``."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.envs.utils import ExplorationType
from torchrl.modules import MLP, IndependentNormal, ProbabilisticActor, ValueOperator

from skatemount.models.activations import ELU
from skatemount.models.base import Networks
from skatemount.models.config import NetworkConfig
from skatemount.models.distributions import BoundedNormalScale
from skatemount.models.normalization import RunningNormalizer
from skatemount.models.symmetry import EquivariantMLP, Reflection

ACTIVATION_CLASSES: dict[str, type[nn.Module]] = {"elu": ELU, "relu": nn.ReLU, "tanh": nn.Tanh, "silu": nn.SiLU}
"""Activations by their name in the settings."""


def _gaussian_actor(network: nn.Module, key: str) -> ProbabilisticActor:
    """Return an actor that samples actions from a normal distribution.

    Args:
        network: Maps the values under ``key`` to means and standard deviations.
        key: Key of the network's input.
    """
    return ProbabilisticActor(
        TensorDictModule(network, [key], ["loc", "scale"]),
        in_keys=["loc", "scale"],
        distribution_class=IndependentNormal,
        return_log_prob=True,
        default_interaction_type=ExplorationType.RANDOM,
    )


class Join(nn.Module):
    """A network applied to its concatenated inputs."""

    def __init__(self, network: nn.Module):
        super().__init__()
        self.network = network

    def forward(self, *parts: Tensor) -> Tensor:
        """Map parts, ``[..., D_i]`` each, to the network's output."""
        return self.network(torch.cat(parts, -1))


class FromEvenOdd(nn.Module):
    """A symmetric network whose input is split by `EquivariantMLP.to_even_odd` already."""

    def __init__(self, network: EquivariantMLP):
        super().__init__()
        self.network = network

    def forward(self, parts: Tensor) -> Tensor:
        """Map ``[..., inputs]`` even and odd parts to ``[..., outputs]``."""
        return self.network.forward_even_odd(parts)


class ActorCritic(Networks):
    """Multilayer perceptrons for actor and critic.

    Args:
        config: Settings of both networks.
        observation: Number of entries of ``observation``.
        privileged: Number of entries of ``privileged``.
        actions: Number of entries of ``action``.
        reflections: Reflections of ``observation``, ``privileged`` and ``action``, for symmetric networks. They are
            saved with the weights, so networks that are made to load weights need none.

    Attributes:
        config: Settings of both networks.
        actor: Writes ``loc``, ``scale``, ``action`` and ``action_log_prob``.
        critic: Writes ``state_value``.
        normalizers: Normalizers of the actor's and of the critic's input; empty without normalization.
    """

    def __init__(
        self,
        config: NetworkConfig,
        observation: int,
        privileged: int,
        actions: int,
        reflections: tuple[Reflection, Reflection, Reflection] | None = None,
    ):
        super().__init__(config, observation, privileged, actions, reflections)
        sizes = (observation, observation + privileged)
        of_observation, of_privileged, of_action = reflections or map(
            Reflection.identity, (observation, privileged, actions)
        )
        inputs = (of_observation, Reflection.concat(of_observation, of_privileged))
        # Saved weights have this name.
        self._images = nn.ModuleList(inputs if config.symmetric else ())
        normalizers = [RunningNormalizer(size) for size in sizes] if config.normalize else []
        self.normalizers = nn.ModuleList(normalizers)

        def network(which: int, cells: list[int], after: Reflection) -> nn.Sequential:
            activation = ACTIVATION_CLASSES[config.activation]
            if config.symmetric:
                return EquivariantMLP(inputs[which], after, cells, activation)
            return MLP(sizes[which], len(after.signs), num_cells=cells, activation_class=activation)

        means = network(0, list(config.actor), of_action)
        with torch.no_grad():
            # The first actions are near the default pose: a robot that stands learns sooner than one that twitches.
            *_, last = (layer for layer in means if isinstance(layer, nn.Linear))
            last.weight.mul_(0.01)
            last.bias.zero_()
        values = network(1, list(config.critic), Reflection.identity(1))
        policy, value = nn.Sequential(*normalizers[:1], means), nn.Sequential(*normalizers[1:], values)
        self._networks = means, values
        deviation = BoundedNormalScale(actions, config, of_action if config.symmetric else None)
        self.actor = _gaussian_actor(nn.Sequential(policy, deviation), "observation")
        self.critic = ValueOperator(Join(value), in_keys=list(self.critic_keys))

    @property
    def description(self) -> str:
        """The sizes of the actor's hidden layers; for a class that derives from this one its name as well."""
        name = "" if type(self) is ActorCritic else f"network {self.config.kind}, "
        return f"{name}actor {list(self.config.actor)}"

    def learners(self, compiled: bool = False) -> tuple[ProbabilisticActor, ValueOperator]:
        """Return an actor and a critic that share the layers and read what `prepare` returns.

        Args:
            compiled: Compile the layers with ``torch.compile``.
        """
        layers: list[Any] = [FromEvenOdd(n) if isinstance(n, EquivariantMLP) else n for n in self._networks]
        if compiled:
            layers = [torch.compile(each) for each in layers]
        means, values = layers
        actor = _gaussian_actor(nn.Sequential(means, self.deviation), "actor_input")
        return actor, ValueOperator(values, in_keys=["critic_input"])

    @torch.no_grad()
    def prepare(self, batch: TensorDictBase) -> TensorDict:
        """Normalize and split a batch once, for several passes over it with unchanged normalizers.

        Args:
            batch: Any shape, with ``observation`` and ``privileged``.

        Returns:
            ``actor_input`` and ``critic_input``, of the batch's shape.
        """
        prepared = TensorDict(batch_size=batch.batch_size, device=batch.device)
        for which, (name, network) in enumerate(zip(("actor_input", "critic_input"), self._networks)):
            keys = (self.actor_keys, self.critic_keys)[which]
            values = torch.cat([batch[key] for key in keys], -1)
            if self.normalizers:
                values = self.normalizers[which](values)
            prepared[name] = network.to_even_odd(values) if isinstance(network, EquivariantMLP) else values
        return prepared

    @property
    def deviation(self) -> BoundedNormalScale:
        """Module of the actions' standard deviation."""
        return next(module for module in self.actor.modules() if isinstance(module, BoundedNormalScale))

    def limit_std(self, high: float) -> None:
        """Lower the upper bound of the actions' standard deviation; keep a bound that is lower already."""
        self.deviation.limit(high)

    def observe(self, batch: TensorDictBase) -> None:
        """Update the normalizers' statistics with a batch."""
        reflections: Iterable[nn.Module | None] = self._images or (None, None)
        for normalizer, keys, reflection in zip(self.normalizers, (self.actor_keys, self.critic_keys), reflections):
            assert isinstance(normalizer, RunningNormalizer) and isinstance(reflection, Reflection | None)
            normalizer.observe(torch.cat([batch[key] for key in keys], -1), reflection)

    def reset_statistics(self) -> None:
        """Reset the normalizers, so that the next observed batch replaces their statistics."""
        for normalizer in self.normalizers:
            assert isinstance(normalizer, RunningNormalizer)
            normalizer.reset_statistics()
