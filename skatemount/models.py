"""Actor and critic: the actor sees ``observation``, the critic ``privileged`` besides."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.envs.utils import ExplorationType
from torchrl.modules import MLP, IndependentNormal, ProbabilisticActor, ValueOperator

from skatemount.activations import ELU
from skatemount.errors import ConfigError
from skatemount.symmetric import Mirror, SymmetricMLP

ACTIVATIONS = {"elu": ELU, "relu": nn.ReLU, "tanh": nn.Tanh, "silu": nn.SiLU}


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

    Attributes:
        mean: ``[size]``.
        var: ``[size]``.
        count: How many of each value it has seen.
        behind: ``[size]``, how many fewer it has seen of a value that came later, with `take_over`. It matters in
            training only, and is not saved with the network.
    """

    mean: Tensor
    var: Tensor
    count: Tensor
    behind: Tensor

    def __init__(self, size: int, clip: float = 10.0):
        super().__init__()
        self._clip = clip
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("var", torch.ones(size))
        self.register_buffer("count", torch.zeros((), dtype=torch.float64))
        self.register_buffer("behind", torch.zeros(size, dtype=torch.float64), persistent=False)

    @torch.no_grad()
    def observe(self, values: Tensor, mirror: Mirror | None = None) -> None:
        """Take values into account.

        Args:
            values: ``[..., size]``.
            mirror: Their mirror images are taken into account, too, if it is given.
        """
        flat = values.flatten(0, -2)
        n = flat.shape[0]
        # Two passes over whole rows; torch's var_mean would go down the columns.
        mean = flat.mean(0)
        var = (flat - mean).square_().mean(0)
        if mirror is not None:
            # The images have the image of the mean, and the variances in another order: no need to make them.
            n, image = 2 * n, mirror(mean)
            var = (var + var[mirror.permutation]) / 2 + ((mean - image) / 2).square()
            mean = (mean + image) / 2
        self.count.add_(n)
        share = (n / (self.count - self.behind)).to(mean.dtype)
        shift = mean - self.mean
        self.var.copy_(self.var * (1 - share) + var * share + shift.square() * share * (1 - share))
        self.mean.add_(shift * share)

    @torch.no_grad()
    def take_over(self, other: RunningNormalizer, places: Tensor) -> None:
        """Continue another one's statistics, as those of the values at the given places, ``[other's size]``.

        All other values begin with what is observed next: the other one's count would hold them where they are.
        """
        self.mean[places], self.var[places] = other.mean, other.var
        self.count.copy_(other.count)
        self.behind.copy_(other.count.expand_as(self.behind))
        self.behind[places] = other.behind

    def forget(self) -> None:
        """Let what is observed next replace what was observed so far, instead of adding to it."""
        self.count.zero_()
        self.behind.zero_()

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


class FromCoordinates(nn.Module):
    """A symmetric network that is given what its `SymmetricMLP.coordinates` returns."""

    def __init__(self, network: SymmetricMLP):
        super().__init__()
        self.network = network

    def forward(self, coordinates: Tensor) -> Tensor:
        """``[..., inputs]`` to ``[..., outputs]``."""
        return self.network.from_coordinates(coordinates)


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
            activation = ACTIVATIONS[config.activation]
            if config.symmetric:
                return SymmetricMLP(images[which], after, cells, activation)
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
        layers: list[Any] = [FromCoordinates(n) if isinstance(n, SymmetricMLP) else n for n in self._networks]
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
            prepared[name] = network.coordinates(values) if isinstance(network, SymmetricMLP) else values
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

    def forget(self) -> None:
        """Let the next batch that is observed replace the normalisers' statistics."""
        for normalizer in self.normalizers:
            assert isinstance(normalizer, RunningNormalizer)
            normalizer.forget()
