"""`Algorithm`: what the training needs of a learning algorithm, such as `skatemount.losses.ppo.PPO`."""

from __future__ import annotations

import abc
from collections.abc import Callable
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

from skatemount.losses.config import ALGORITHMS, AlgorithmConfig
from skatemount.models.base import Networks, is_own
from skatemount.models.trial import STEPS, WORLDS, example_batch, unchanged
from skatemount.utils.classes import made
from skatemount.utils.errors import ConfigError, reason
from skatemount.utils.ranks import ALONE, Ranks


class NotFinite(FloatingPointError):
    """A batch has a value that is not finite.

    Args:
        message: Says where.
        key: Key of the value in the batch, without ``next``.
        columns: ``[size]`` bool, the entries of the key that are not finite in the first such step.
    """

    def __init__(self, message: str, key: str, columns: Tensor):
        super().__init__(message)
        self.key, self.columns = key, columns


class Algorithm(abc.ABC):
    """Base class of algorithms: `update` learns from a batch, and the state can be saved.

    ``algorithm.kind`` names the class: a name registered with ``ALGORITHMS.register(name)``, or ``module:Class``. The
    constructor takes what is listed here, and then parameters of its own, which ``algorithm.params`` gives. For another
    loss with the same minibatches, derive from `PPO` and override `PPO.make_loss`.

    Args:
        config: Hyperparameters.
        networks: Actor and critic.
        control_step: Time between two actions, s.
        bf16: Compute the matrix products of updates in bfloat16.
        generator: Source of randomness, whose state is saved with the training.

    Attributes:
        teacher: Returns the mean actions of a policy to imitate, ``[N, T, J]``, for a batch; see
            `skatemount.agents.teacher.Teacher`. The training sets it if ``algorithm.teacher`` names one.
        ranks: The processes that train one policy together. With more than one, `update` gets a batch of its own on
            every rank and must leave the same weights on all of them: average the gradients, and all that the update
            depends on, with its methods.
    """

    teacher: Callable[[TensorDictBase], Tensor] | None = None
    ranks: Ranks = ALONE

    def __init__(
        self,
        config: AlgorithmConfig,
        networks: Networks,
        control_step: float,
        bf16: bool = False,
        generator: torch.Generator | None = None,
    ):
        self.config = config
        self.networks = networks
        self.control_step = control_step

    @abc.abstractmethod
    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """Update the networks in place from a batch.

        Args:
            batch: ``[N, T]`` as a TorchRL collector yields it.

        Returns:
            Metrics, under ``Loss/*``.

        Raises:
            FloatingPointError: A value is not finite. From `NotFinite` the training finds out which term gave it.
        """

    @abc.abstractmethod
    def state_dict(self) -> dict[str, Any]:
        """Return the state for a checkpoint: nested dicts with string keys of tensors and plain values."""

    @abc.abstractmethod
    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` returned."""

    def try_out(self, batch: TensorDictBase) -> None:  # noqa: B027  # optional
        """Compute what `update` computes from a batch, and change nothing, to find mistakes before anything is trained.

        Called once if the algorithm or the networks are a user's; weights and torch's random state are restored after
        it.

        Args:
            batch: ``[N, T]`` of random observations.

        Raises:
            ConfigError: Something that `update` needs is missing.
        """

    def step_schedules(self, frames: int, total_frames: int) -> None:  # noqa: B027  # optional
        """Set what depends on the time; called after each update, and when a run resumes.

        Args:
            frames: Number of frames trained so far.
            total_frames: Number of frames of the whole training.
        """

    def use_min_learning_rate(self) -> None:  # noqa: B027  # optional
        """Start gently, because the networks are already trained."""


def make_algorithm(
    config: AlgorithmConfig,
    networks: Networks,
    control_step: float,
    bf16: bool = False,
    generator: torch.Generator | None = None,
) -> Algorithm:
    """Make the algorithm that the settings name; the arguments are those of `Algorithm`.

    Raises:
        ConfigError: There is no such class, it cannot be made with these settings, or it cannot learn.
    """
    cls = ALGORITHMS.find(config.kind, "algorithm.kind")
    where = f"algorithm.kind={config.kind}"
    algorithm: Algorithm = made(
        cls, where, config, networks, control_step, bf16=bf16, generator=generator, **config.params
    )
    named = {f"network.kind={networks.config.kind}": networks, where: algorithm}
    if own := [setting for setting, each in named.items() if is_own(each)]:
        try:
            with unchanged(networks):
                algorithm.try_out(example_batch(networks))
        except ConfigError:
            raise
        except Exception as error:
            tried = f"{WORLDS} worlds and {STEPS} steps"
            raise ConfigError(f"{', '.join(own)}: learning failed when tried with {tried}: {reason(error)}") from error
    return algorithm
