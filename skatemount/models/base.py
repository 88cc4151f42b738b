"""`Networks`: what the training needs of actor and critic, such as `skatemount.models.actor_critic.ActorCritic`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn

from skatemount.models.config import NETWORKS, NetworkConfig
from skatemount.models.symmetry import Reflection
from skatemount.models.trial import try_networks
from skatemount.utils.classes import made
from skatemount.utils.errors import ConfigError
from skatemount.utils.formatting import format_count

if TYPE_CHECKING:
    from torchrl.envs import Transform


class Networks(nn.Module):
    """Base class of actor and critic.

    ``network.kind`` names the class: a name registered with ``NETWORKS.register(name)``, or ``module:Class``. The
    constructor takes what is listed here, and then parameters of its own, which ``network.params`` gives. It must set
    `actor` and `critic`. The same constructor makes the networks for a training and for saved weights, so everything
    that the weights do not hold must follow from its arguments.

    Args:
        config: Settings of both networks.
        observation: Number of entries of ``observation``.
        privileged: Number of entries of ``privileged``.
        actions: Number of entries of ``action``.
        reflections: Reflections of ``observation``, ``privileged`` and ``action``, if ``network.symmetric`` is on and
            the networks are new. With them a mirrored observation must give the mirrored action and the same value.

    Attributes:
        config: Settings of both networks.
        sizes: Numbers of entries of ``observation``, ``privileged`` and ``action``.
        actor: TorchRL actor: reads `actor_keys`, and writes ``loc``, ``scale``, ``action`` and ``action_log_prob``.
        critic: Reads `critic_keys`, and writes ``state_value``.
        actor_keys: Observations that the actor reads.
        critic_keys: Observations that the critic reads.
        state_keys: Keys of the actor's memory: it reads them, and writes them under ``next``. Empty without memory.
    """

    actor: Any
    critic: Any
    actor_keys: Sequence[str] = ("observation",)
    critic_keys: Sequence[str] = ("observation", "privileged")
    state_keys: Sequence[str] = ()

    def __init__(
        self,
        config: NetworkConfig,
        observation: int,
        privileged: int,
        actions: int,
        reflections: tuple[Reflection, Reflection, Reflection] | None = None,
    ):
        super().__init__()
        config.validate()
        self.config = config
        self.sizes = observation, privileged, actions

    @property
    def description(self) -> str:
        """The networks in a few words, for the line with which a training starts."""
        count = sum(each.numel() for each in self.parameters())
        return f"network {self.config.kind} ({format_count(count)} weights)"

    @property
    def recurrent(self) -> bool:
        """True if the actor has memory: then it learns from whole sequences, ``[worlds, T]``."""
        return bool(self.state_keys)

    def transforms(self) -> list[Transform]:
        """Return TorchRL transforms of the environment that an actor with memory needs; a new list each time.

        They are `torchrl.envs.InitTracker`, which writes ``is_init``, and the primer of the memory.
        """
        return []

    def learners(self, compiled: bool = False) -> tuple[TensorDictModuleBase, TensorDictModuleBase]:
        """Return an actor and a critic that share the weights and read what `prepare` returns.

        Args:
            compiled: Compile the layers with ``torch.compile``.

        Raises:
            ConfigError: ``algorithm.compile`` is on, and these networks cannot be compiled.
        """
        if compiled:
            raise ConfigError(f"algorithm.compile=true: network.kind={self.config.kind} cannot be compiled")
        return self.actor, self.critic

    def prepare(self, batch: TensorDictBase) -> TensorDictBase:
        """Return from a batch what the learners read; the normalizers stay unchanged while it is learned from.

        Args:
            batch: ``[N, T]``, as it was collected.

        Returns:
            The inputs of the learners, of the batch's shape.
        """
        return batch.select(*dict.fromkeys([*self.critic.in_keys, *self.actor.in_keys]))

    def observe(self, batch: TensorDictBase) -> None:
        """Update the statistics of the observations with a batch, before it is learned from."""

    def reset_statistics(self) -> None:
        """Forget the statistics of the observations, so that the next batch replaces them."""

    def limit_std(self, high: float) -> None:
        """Lower the upper bound of the actions' standard deviation; keep a bound that is lower already."""

    def actor_in(self, env: Any) -> Callable[[TensorDictBase], TensorDictBase]:
        """Return an actor for an environment, with a memory of its own; see `skatemount.agents.policy.Policy`.

        Args:
            env: The `skatemount.envs.MountEnv`. The memory of a world is forgotten when its episode begins.
        """
        if not self.recurrent:
            actor: Callable[[TensorDictBase], TensorDictBase] = self.actor
            return actor
        memory: dict[str, Tensor] = {}

        def act(state: TensorDictBase) -> TensorDictBase:
            begins = (env.episode.step == 0).unsqueeze(1)
            known = TensorDict(batch_size=[env.num_worlds], device=env.device)
            known.update({key: state[key] for key in self.actor_keys})
            known["is_init"] = begins
            for key, value in memory.items():
                known[key] = torch.where(begins.view(-1, *[1] * (value.ndim - 1)), 0.0, value)
            result = self.actor(known)
            memory.update({key: result["next", key] for key in self.state_keys})
            return state.update({"action": result["action"]})

        return act


def is_own(made: object) -> bool:
    """Return whether the class of networks or of an algorithm is a user's, whose mistakes are looked for."""
    return not type(made).__module__.startswith("skatemount.")


def make_networks(
    config: NetworkConfig,
    observation: int,
    privileged: int,
    actions: int,
    reflections: tuple[Reflection, Reflection, Reflection] | None = None,
) -> Networks:
    """Make the networks that the settings name; the arguments are those of `Networks`.

    Raises:
        ConfigError: There is no such class, it cannot be made with these settings, or its networks cannot be used.
    """
    cls = NETWORKS.find(config.kind, "network.kind")
    where = f"network.kind={config.kind}"
    networks: Networks = made(cls, where, config, observation, privileged, actions, reflections, **config.params)
    if missing := [name for name in ("actor", "critic") if not isinstance(getattr(networks, name, None), nn.Module)]:
        raise ConfigError(f"{where}: {cls.__name__} of {cls.__module__} must set {' and '.join(missing)}")
    if is_own(networks):
        try_networks(networks, reflections)
    return networks
