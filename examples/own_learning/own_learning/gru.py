"""An actor with memory: a gated recurrent unit between the observation and the action."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor, nn
from torchrl.envs import InitTracker, Transform
from torchrl.envs.utils import ExplorationType
from torchrl.modules import MLP, GRUModule, IndependentNormal, ProbabilisticActor, ValueOperator

from skatemount.models.base import Networks
from skatemount.models.config import NetworkConfig
from skatemount.models.distributions import BoundedNormalScale
from skatemount.models.normalization import RunningNormalizer
from skatemount.models.symmetry import Reflection


class Joined(nn.Module):
    """A network applied to its concatenated inputs."""

    def __init__(self, *layers: nn.Module):
        super().__init__()
        self.layers = nn.Sequential(*layers)

    def forward(self, *parts: Tensor) -> Tensor:
        """Map parts, ``[..., D_i]`` each, to the network's output."""
        return self.layers(torch.cat(parts, -1))


class GruActorCritic(Networks):
    """An actor that reads the observation and the output of a GRU, and a critic without memory.

    Args:
        hidden: Size of the memory.
    """

    state_keys = ("memory",)

    def __init__(
        self,
        config: NetworkConfig,
        observation: int,
        privileged: int,
        actions: int,
        reflections: tuple[Reflection, Reflection, Reflection] | None = None,
        hidden: int = 64,
    ):
        super().__init__(config, observation, privileged, actions, reflections)
        self.normalizers = nn.ModuleList([RunningNormalizer(observation), RunningNormalizer(observation + privileged)])
        self.gru = GRUModule(
            observation, hidden, in_keys=["normalized", "memory"], out_keys=["remembered", ("next", "memory")]
        )
        means = MLP(observation + hidden, actions, num_cells=config.actor, activation_class=nn.ELU)
        with torch.no_grad():
            means[-1].weight.mul_(0.01)
            means[-1].bias.zero_()
        self.deviation = BoundedNormalScale(actions, config)
        self.actor = ProbabilisticActor(
            TensorDictSequential(
                TensorDictModule(self.normalizers[0], ["observation"], ["normalized"]),
                self.gru,
                TensorDictModule(Joined(means, self.deviation), ["normalized", "remembered"], ["loc", "scale"]),
            ),
            in_keys=["loc", "scale"],
            distribution_class=IndependentNormal,
            return_log_prob=True,
            default_interaction_type=ExplorationType.RANDOM,
        )
        values = MLP(observation + privileged, 1, num_cells=config.critic, activation_class=nn.ELU)
        self.critic = ValueOperator(Joined(self.normalizers[1], values), in_keys=list(self.critic_keys))

    def transforms(self) -> list[Transform]:
        """Return the transforms that mark the first steps of episodes and carry the memory."""
        return [InitTracker(), self.gru.make_tensordict_primer()]

    def observe(self, batch: TensorDictBase) -> None:
        """Update the normalizers' statistics with a batch."""
        for normalizer, keys in zip(self.normalizers, (self.actor_keys, self.critic_keys)):
            normalizer.observe(torch.cat([batch[key] for key in keys], -1))

    def reset_statistics(self) -> None:
        """Reset the normalizers."""
        for normalizer in self.normalizers:
            normalizer.reset_statistics()

    def limit_std(self, high: float) -> None:
        """Lower the upper bound of the actions' standard deviation."""
        self.deviation.limit(high)
