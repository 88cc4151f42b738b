"""Actor and critic: the actor sees ``observation``, the critic ``privileged`` besides."""

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
from skatemount.models.config import NetworkConfig
from skatemount.models.distributions import BoundedNormalScale
from skatemount.models.normalization import RunningNormalizer
from skatemount.models.symmetry import EquivariantMLP, Mirror

_ACTIVATIONS: dict[str, type[nn.Module]] = {"elu": ELU, "relu": nn.ReLU, "tanh": nn.Tanh, "silu": nn.SiLU}


def _gaussian_actor(network: nn.Module, key: str) -> ProbabilisticActor:
    """Draws actions from the normal distribution whose means and deviations a network makes of what is under a key."""
    return ProbabilisticActor(
        TensorDictModule(network, [key], ["loc", "scale"]),
        in_keys=["loc", "scale"],
        distribution_class=IndependentNormal,
        return_log_prob=True,
        default_interaction_type=ExplorationType.RANDOM,
    )


class Join(nn.Module):
    """Concatenates its inputs, then applies a network."""

    def __init__(self, network: nn.Module):
        super().__init__()
        self.network = network

    def forward(self, *parts: Tensor) -> Tensor:
        """``[..., D_i]`` each to the network's output."""
        return self.network(torch.cat(parts, -1))


class FromEvenOdd(nn.Module):
    """A symmetric network that is given what its `EquivariantMLP.coordinates` returns."""

    def __init__(self, network: EquivariantMLP):
        super().__init__()
        self.network = network

    def forward(self, coordinates: Tensor) -> Tensor:
        """``[..., inputs]`` to ``[..., outputs]``."""
        return self.network.forward_even_odd(coordinates)


class ActorCritic(nn.Module):
    """The two networks and how they read a tensordict.

    Args:
        config: Sizes.
        observation: Values in ``observation``.
        privileged: Values in ``privileged``.
        actions: Values in ``action``.
        mirrors: Mirror images of ``observation``, ``privileged`` and ``action``, for symmetric networks; they are
            saved with the weights, so that networks whose weights are loaded need none.

    Attributes:
        config: Sizes.
        actor: Writes ``loc``, ``scale``, ``action`` and ``action_log_prob``.
        critic: Writes ``state_value``.
        normalizers: Of the actor's and of the critic's input; empty without normalisation.
    """

    actor_keys = ("observation",)
    critic_keys = ("observation", "privileged")

    def __init__(
        self,
        config: NetworkConfig,
        observation: int,
        privileged: int,
        actions: int = 12,
        mirrors: tuple[Mirror, Mirror, Mirror] | None = None,
    ):
        super().__init__()
        config.validate()
        self.config = config
        sizes = (observation, observation + privileged)
        seen, hidden, acts = mirrors or map(Mirror.same, (observation, privileged, actions))
        images = (seen, Mirror.joined(seen, hidden))
        self._images = nn.ModuleList(images if config.symmetric else ())
        normalizers = [RunningNormalizer(size) for size in sizes] if config.normalize else []
        self.normalizers = nn.ModuleList(normalizers)

        def network(which: int, cells: list[int], after: Mirror) -> nn.Sequential:
            activation = _ACTIVATIONS[config.activation]
            if config.symmetric:
                return EquivariantMLP(images[which], after, cells, activation)
            return MLP(sizes[which], len(after.signs), num_cells=cells, activation_class=activation)

        means = network(0, list(config.actor), acts)
        with torch.no_grad():
            # The first actions are the default pose: a robot that stands learns sooner than one that twitches.
            *_, last = (layer for layer in means if isinstance(layer, nn.Linear))
            last.weight.mul_(0.01)
            last.bias.zero_()
        values = network(1, list(config.critic), Mirror.same(1))
        policy, value = nn.Sequential(*normalizers[:1], means), nn.Sequential(*normalizers[1:], values)
        self._networks = means, values
        deviation = BoundedNormalScale(actions, config, acts if config.symmetric else None)
        self.actor = _gaussian_actor(nn.Sequential(policy, deviation), "observation")
        self.critic = ValueOperator(Join(value), in_keys=list(self.critic_keys))

    def learners(self, compiled: bool = False) -> tuple[ProbabilisticActor, ValueOperator]:
        """Actor and critic with the same layers, that read what `prepare` returns.

        Args:
            compiled: By ``torch.compile``.
        """
        layers: list[Any] = [FromEvenOdd(n) if isinstance(n, EquivariantMLP) else n for n in self._networks]
        if compiled:
            layers = [torch.compile(each) for each in layers]
        means, values = layers
        actor = _gaussian_actor(nn.Sequential(means, self.deviation), "actor_input")
        return actor, ValueOperator(values, in_keys=["critic_input"])

    @torch.no_grad()
    def prepare(self, batch: TensorDictBase) -> TensorDict:
        """What the layers see of a batch, for several passes over it while the normalisers rest.

        Returns:
            ``actor_input`` and ``critic_input``, of the batch's size.
        """
        prepared = TensorDict(batch_size=batch.batch_size, device=batch.device)
        for which, (name, network) in enumerate(zip(("actor_input", "critic_input"), self._networks)):
            keys = (self.actor_keys, self.critic_keys)[which]
            values = torch.cat([batch[key] for key in keys], -1)
            if self.normalizers:
                values = self.normalizers[which](values)
            prepared[name] = network.coordinates(values) if isinstance(network, EquivariantMLP) else values
        return prepared

    @property
    def deviation(self) -> BoundedNormalScale:
        """The actions' standard deviation."""
        return next(module for module in self.actor.modules() if isinstance(module, BoundedNormalScale))

    def limit_std(self, high: float) -> None:
        """Lower the upper bound of the actions' standard deviation; a bound that is lower already stays."""
        self.deviation.limit(high)

    def observe(self, batch: TensorDictBase) -> None:
        """Let the normalisers take a batch into account."""
        images: Iterable[nn.Module | None] = self._images or (None, None)
        for normalizer, keys, image in zip(self.normalizers, (self.actor_keys, self.critic_keys), images):
            assert isinstance(normalizer, RunningNormalizer) and isinstance(image, Mirror | None)
            normalizer.observe(torch.cat([batch[key] for key in keys], -1), image)

    def reset_statistics(self) -> None:
        """Let the next batch that is observed replace the normalisers' statistics."""
        for normalizer in self.normalizers:
            assert isinstance(normalizer, RunningNormalizer)
            normalizer.reset_statistics()
