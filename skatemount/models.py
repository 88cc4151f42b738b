"""Actor and critic: the actor sees ``observation``, the critic ``privileged`` besides."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.envs.utils import ExplorationType
from torchrl.modules import MLP, IndependentNormal, ProbabilisticActor, ValueOperator

from skatemount.errors import ConfigError
from skatemount.symmetric import Mirror, symmetric_mlp

ACTIVATIONS = {"elu": nn.ELU, "relu": nn.ReLU, "tanh": nn.Tanh, "silu": nn.SiLU}


@dataclass
class NetworkConfig:
    """Sizes of the networks.

    Attributes:
        actor: Hidden layers of the actor.
        critic: Hidden layers of the critic.
        activation: ``elu``, ``relu``, ``tanh`` or ``silu``.
        init_std: Standard deviation of the actions at the start, in units of the action scale.
        min_std: Lowest standard deviation that learning may reach.
        max_std: Highest.
        normalize: Normalise observations by their running mean and deviation, inside the networks.
        symmetric: Build the networks so that the mirror image of a state gives the mirror image of the action, and
            the same value.
    """

    actor: list[int] = field(default_factory=lambda: [256, 128, 64])
    critic: list[int] = field(default_factory=lambda: [256, 128, 64])
    activation: str = "elu"
    init_std: float = 0.5
    min_std: float = 0.05
    max_std: float = 1.0
    normalize: bool = True
    symmetric: bool = False

    def validate(self, where: str = "network") -> None:
        """Raise `ConfigError` for sizes that cannot be built."""
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


class RunningNormalizer(nn.Module):
    """Normalises by running mean and deviation, kept as buffers so that they are saved and exported with the network.

    Chan, Golub and LeVeque's update for batches (1983).

    Args:
        size: Values.
        clip: Bound on the normalised values.
    """

    mean: Tensor
    var: Tensor
    count: Tensor

    def __init__(self, size: int, clip: float = 10.0):
        super().__init__()
        self._clip = clip
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("var", torch.ones(size))
        self.register_buffer("count", torch.zeros((), dtype=torch.float64))

    @torch.no_grad()
    def observe(self, values: Tensor) -> None:
        """Take ``[..., size]`` values into account."""
        flat = values.flatten(0, -2)
        n = flat.shape[0]
        var, mean = torch.var_mean(flat, 0, correction=0)
        total = self.count + n
        share = (n / total).to(mean.dtype)
        shift = mean - self.mean
        self.var.copy_(self.var * (1 - share) + var * share + shift.square() * share * (1 - share))
        self.mean.add_(shift * share)
        self.count.copy_(total)

    def forget(self) -> None:
        """Let what is observed next replace what was observed so far, instead of adding to it."""
        self.count.zero_()

    def forward(self, values: Tensor) -> Tensor:
        """``[..., size]`` to the same, with mean 0 and deviation 1, clipped."""
        return ((values - self.mean) * torch.rsqrt(self.var + 1e-4)).clamp(-self._clip, self._clip)


class BoundedNormalScale(nn.Module):
    """A learned standard deviation for each action, independent of the state and positive by construction.

    std = low + (high - low) sigmoid(parameter). The upper bound is a buffer, so that it is saved with the network.

    Args:
        size: Actions.
        config: Bounds and start.
        mirror: Mirror image of the actions, if both are to have the same deviation.
    """

    high: Tensor

    def __init__(self, size: int, config: NetworkConfig, mirror: Mirror | None = None):
        super().__init__()
        self._mirror = mirror
        self._low, span = config.min_std, config.max_std - config.min_std
        share = (config.init_std - self._low) / span if span else 0.5
        share = min(max(share, 1e-3), 1 - 1e-3)
        self.parameter = nn.Parameter(torch.full((size,), math.log(share / (1 - share))))
        self.register_buffer("high", torch.tensor(config.max_std))

    def limit(self, high: float) -> None:
        """Lower the upper bound, and with it every deviation; a bound that is lower already stays."""
        self.high.clamp_(max=max(high, self._low))

    def forward(self, loc: Tensor) -> tuple[Tensor, Tensor]:
        """``[..., size]`` means to means and standard deviations."""
        parameter: Tensor = self.parameter
        if self._mirror is not None:
            parameter = (parameter + parameter[self._mirror.permutation]) / 2
        std = self._low + (self.high - self._low) * torch.sigmoid(parameter)
        return loc, std.expand_as(loc)


class Join(nn.Module):
    """Concatenates its inputs, then applies a network."""

    def __init__(self, network: nn.Module):
        super().__init__()
        self.network = network

    def forward(self, *parts: Tensor) -> Tensor:
        """``[..., D_i]`` each to the network's output."""
        return self.network(torch.cat(parts, -1))


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
        limit_std: Lowers the upper bound of the actions' standard deviation.
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
            activation = ACTIVATIONS[config.activation]
            if config.symmetric:
                return symmetric_mlp(images[which], after, cells, activation)
            return MLP(sizes[which], len(after.signs), num_cells=cells, activation_class=activation)

        means = network(0, list(config.actor), acts)
        with torch.no_grad():
            # The first actions are the default pose: a robot that stands learns sooner than one that twitches.
            *_, last = (layer for layer in means if isinstance(layer, nn.Linear))
            last.weight.mul_(0.01)
            last.bias.zero_()
        policy = nn.Sequential(*normalizers[:1], means)
        value = nn.Sequential(*normalizers[1:], network(1, list(config.critic), Mirror.same(1)))
        deviation = BoundedNormalScale(actions, config, acts if config.symmetric else None)
        self.limit_std = deviation.limit
        self.actor = ProbabilisticActor(
            TensorDictModule(nn.Sequential(policy, deviation), ["observation"], ["loc", "scale"]),
            in_keys=["loc", "scale"],
            distribution_class=IndependentNormal,
            return_log_prob=True,
            default_interaction_type=ExplorationType.RANDOM,
        )
        self.critic = ValueOperator(Join(value), in_keys=list(self.critic_keys))

    def distribution(self, batch: TensorDictBase) -> IndependentNormal:
        """The distribution of actions; the batch is left as it is."""
        return self.actor.get_dist(batch.select(*self.actor_keys))

    def observe(self, batch: TensorDictBase) -> None:
        """Let the normalisers take a batch into account."""
        for which, (normalizer, keys) in enumerate(zip(self.normalizers, (self.actor_keys, self.critic_keys))):
            assert isinstance(normalizer, RunningNormalizer)
            values = torch.cat([batch[key] for key in keys], -1)
            normalizer.observe(torch.cat((values, self._images[which](values))) if self._images else values)

    def forget(self) -> None:
        """Let the next batch that is observed replace the normalisers' statistics."""
        for normalizer in self.normalizers:
            assert isinstance(normalizer, RunningNormalizer)
            normalizer.forget()
