"""`Algorithm`: what the training needs of a learning algorithm, such as `skatemount.losses.ppo.PPO`."""

from __future__ import annotations

import abc
from typing import Any

import torch
from tensordict import TensorDictBase

from skatemount.losses.config import ALGORITHMS, AlgorithmConfig
from skatemount.models.base import Networks
from skatemount.utils.classes import made


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
    """

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
            FloatingPointError: A value is not finite.
        """

    @abc.abstractmethod
    def state_dict(self) -> dict[str, Any]:
        """Return the state for a checkpoint: nested dicts with string keys of tensors and plain values."""

    @abc.abstractmethod
    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` returned."""

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
        ConfigError: There is no such class, or it cannot be made with these settings.
    """
    cls = ALGORITHMS.find(config.kind, "algorithm.kind")
    where = f"algorithm.kind={config.kind}"
    algorithm: Algorithm = made(
        cls, where, config, networks, control_step, bf16=bf16, generator=generator, **config.params
    )
    return algorithm
