"""Settings of the learning algorithm."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from skatemount.utils.bounds import check_bounds, number
from skatemount.utils.classes import ClassRegistry
from skatemount.utils.errors import ConfigError

ALGORITHMS = ClassRegistry(
    "algorithm",
    {"ppo": "skatemount.losses.ppo:PPO"},
    methods=("update", "state_dict", "load_state_dict", "step_schedules", "use_min_learning_rate"),
    base="skatemount.losses.base.Algorithm",
    given=("config", "networks", "control_step", "bf16", "generator"),
)
"""Learning algorithms by ``algorithm.kind``."""


@dataclass
class AlgorithmConfig:
    """Hyperparameters of PPO, and of algorithms that build on it.

    Attributes:
        kind: Class of the algorithm: ``ppo`` (`skatemount.losses.ppo.PPO`), the name of a plugin's, or
            ``module:Class`` of your own.
        params: Parameters of your own class, by name.
        epochs: Number of passes over a batch.
        minibatches: Number of minibatches of a batch, each of them one gradient step.
        learning_rate: Initial learning rate.
        min_learning_rate: Lower bound of the learning rate as it follows the KL.
        max_learning_rate: Upper bound of the learning rate as it follows the KL.
        target_kl: Target KL divergence between the policies before and after an update; the learning rate adapts to it.
            null for a constant learning rate.
        clip_epsilon: Clipping range of the probability ratio.
        clip_value: Also clip the change of the value by ``clip_epsilon``.
        critic_coeff: Weight of the value loss.
        entropy_coeff: Weight of the entropy bonus.
        discount_horizon: Time constant of the discount, s: ``gamma = exp(-control_step / discount_horizon)``.
        gae_horizon: Time constant of GAE, s: ``lambda = exp(-control_step / gae_horizon)``.
        max_grad_norm: Largest norm of the gradient.
        final_std: Final upper bound of the actions' standard deviation; it falls exponentially from
            ``network.max_std``. null keeps the bound.
        std_frames: Number of frames over which the bound falls.
        final_target_kl: Final ``target_kl``; it falls exponentially at the end of a training. null keeps ``target_kl``.
            Small updates at the end converge where large ones keep moving the policy.
        kl_anneal_fraction: Share of all frames, at the end, over which ``target_kl`` falls.
        teacher: Policy that the actor imitates in addition to what it learns from rewards; what ``checkpoint`` takes.
            null for none. It reads ``privileged``, so it can know what the actor does not see.
        teacher_coeff: Initial weight of the imitation, see `skatemount.losses.imitation`.
        teacher_frames: Number of frames over which the weight falls linearly to 0. The learning rate falls with it to
            ``min_learning_rate``, and does not follow the KL divergence, which is large during an imitation.
        compile: Compile the networks for the updates with torch. Updates are faster, but the first one takes a minute,
            and a C++ compiler must be installed.
    """

    kind: str
    params: dict[str, Any]
    epochs: int = field(metadata=number(1, 1000))
    minibatches: int = field(metadata=number(1, 100_000))
    learning_rate: float = field(metadata=number(0, 10, above=True))
    min_learning_rate: float = field(metadata=number(0, 10, above=True))
    max_learning_rate: float = field(metadata=number(0, 10, above=True))
    target_kl: float | None = field(metadata=number(0, 10_000, above=True))
    clip_epsilon: float = field(metadata=number(0, 10, above=True))
    clip_value: bool
    critic_coeff: float = field(metadata=number(0, 1000))
    entropy_coeff: float = field(metadata=number(0, 100))
    discount_horizon: float = field(metadata=number(0, 100_000, "s", above=True))
    gae_horizon: float = field(metadata=number(0, 100_000, "s", above=True))
    max_grad_norm: float = field(metadata=number(0, 1e9, above=True))
    final_std: float | None = field(metadata=number(0, 100, above=True))
    std_frames: int = field(metadata=number(1, 10**12))
    final_target_kl: float | None = field(metadata=number(0, 10, above=True))
    kl_anneal_fraction: float = field(metadata=number(0, 1, above=True))
    teacher: str | None
    teacher_coeff: float = field(metadata=number(0, 1000))
    teacher_frames: int = field(metadata=number(1, 10**12))
    compile: bool

    def validate(self, where: str = "algorithm") -> None:
        """Raise `ConfigError` if a setting cannot be used."""
        ALGORITHMS.check_choice(self.kind, self.params, where)
        check_bounds(self, where)
        if self.min_learning_rate > self.max_learning_rate:
            raise ConfigError(
                f"{where}.min_learning_rate={self.min_learning_rate} must be at most "
                f"max_learning_rate={self.max_learning_rate}"
            )
        if self.target_kl is not None and not self.min_learning_rate <= self.learning_rate <= self.max_learning_rate:
            raise ConfigError(
                f"{where}.learning_rate={self.learning_rate} must be within min_learning_rate={self.min_learning_rate} "
                f"and max_learning_rate={self.max_learning_rate}, between which it follows the KL"
            )
        if self.final_target_kl is not None and self.target_kl is None:
            raise ConfigError(
                f"{where}.final_target_kl={self.final_target_kl} needs {where}.target_kl, from which it falls"
            )
        if self.final_target_kl is not None and self.target_kl is not None and self.final_target_kl > self.target_kl:
            raise ConfigError(
                f"{where}.final_target_kl={self.final_target_kl} must be at most {where}.target_kl={self.target_kl}, "
                f"from which it "
                "falls"
            )
