"""Settings of PPO."""

from __future__ import annotations

import math
from dataclasses import dataclass

from skatemount.utils.errors import ConfigError


@dataclass
class AlgorithmConfig:
    """Hyper-parameters of PPO.

    Attributes:
        epochs: Passes over a batch.
        minibatches: ObservationLayout of a batch; one update each.
        learning_rate: At the start.
        min_learning_rate: Lowest that the KL may push it to.
        max_learning_rate: Highest.
        target_kl: KL divergence of the policy before a batch from the one after it that the learning rate aims at;
            null keeps the learning rate.
        clip_epsilon: Of the probability ratio.
        clip_value: Clip the value loss by the same amount.
        critic_coeff: Weight of the value loss.
        entropy_coeff: Weight of the entropy bonus.
        discount_horizon: Seconds over which rewards are discounted: gamma = exp(-control step / discount_horizon).
        gae_horizon: Seconds over which GAE looks ahead: lambda = exp(-control step / gae_horizon).
        max_grad_norm: Largest norm of the gradient.
        final_std: What the upper bound of the actions' standard deviation falls to, from ``network.max_std``; null
            leaves it there.
        std_frames: Frames until it is there; it falls by the same share in each.
        final_target_kl: What ``target_kl`` falls to over the last frames, by the same share in each; null leaves it.
            Small steps at the end kl_anneal_fraction a policy that large ones have kept moving about.
        kl_anneal_fraction: Share of all frames over which it does.
        compile: Let torch compile the networks for the updates: they are faster, the first one takes a minute, and a
            C++ compiler must be installed.
    """

    epochs: int
    minibatches: int
    learning_rate: float
    min_learning_rate: float
    max_learning_rate: float
    target_kl: float | None
    clip_epsilon: float
    clip_value: bool
    critic_coeff: float
    entropy_coeff: float
    discount_horizon: float
    gae_horizon: float
    max_grad_norm: float
    final_std: float | None
    std_frames: int
    final_target_kl: float | None
    kl_anneal_fraction: float
    compile: bool

    def validate(self, where: str = "algorithm") -> None:
        """Raise `ConfigError` for values that cannot be used."""
        for name in ("epochs", "minibatches"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{where}.{name}={getattr(self, name)} must be at least 1")
        positive = (
            "learning_rate",
            "min_learning_rate",
            "max_learning_rate",
            "clip_epsilon",
            "discount_horizon",
            "gae_horizon",
        )
        for name in (
            *positive,
            "max_grad_norm",
            "target_kl",
            "final_std",
            "std_frames",
            "final_target_kl",
            "kl_anneal_fraction",
        ):
            value = getattr(self, name)
            if value is not None and not 0 < value < math.inf:
                raise ConfigError(f"{where}.{name}={value} must be above 0 and finite")
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
        if self.kl_anneal_fraction > 1:
            raise ConfigError(
                f"{where}.kl_anneal_fraction={self.kl_anneal_fraction} must be a share of the frames, at most 1"
            )
        for name in ("critic_coeff", "entropy_coeff"):
            if not getattr(self, name) >= 0:
                raise ConfigError(f"{where}.{name}={getattr(self, name)} must be 0 or more")
