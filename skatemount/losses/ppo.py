"""PPO with TorchRL's `ClipPPOLoss` and `GAE`, exact bootstrapping at time-outs, and an adaptive learning rate."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torch._dynamo.exc import BackendCompilerFailed
from torchrl.modules import IndependentNormal
from torchrl.objectives import ClipPPOLoss, KLAdaptiveLR
from torchrl.objectives.value import GAE

from skatemount.losses.config import AlgorithmConfig
from skatemount.models.actor_critic import ActorCritic
from skatemount.utils.errors import ConfigError

LOSS_KEYS = ("action", "action_log_prob", "advantage", "value_target", "state_value")
"""Keys of a batch that the loss reads, in addition to the inputs of the networks."""

KL_STATES = 4096
"""Number of states in which the KL of an update is measured; up to twice as many if it does not divide the batch."""


def _anneal(first: float, last: float, share: float) -> float:
    """Return the value after a share of an exponential fall from the first to the last value."""
    return first * (last / first) ** min(max(share, 0.0), 1.0)


def _moments(distribution: IndependentNormal) -> tuple[Tensor, Tensor]:
    """Return means and standard deviations in float32."""
    normal = distribution.base_dist
    return normal.loc.float(), normal.scale.float()


class PPO:
    """Proximal policy optimization of an `ActorCritic` (Schulman et al., 2017).

    Args:
        config: Hyperparameters.
        networks: Actor and critic.
        control_step: Time between two actions, s.
        bf16: Compute the matrix products of updates in bfloat16.
        generator: Source of randomness for the order of the minibatches.

    Attributes:
        config: Hyperparameters.
        networks: Actor and critic.
        loss: TorchRL's loss.
        optimizer: Adam.
    """

    def __init__(
        self,
        config: AlgorithmConfig,
        networks: ActorCritic,
        control_step: float,
        bf16: bool = False,
        generator: torch.Generator | None = None,
    ):
        self.config = config
        self.networks = networks
        self._bf16 = bf16
        self._generator = generator
        self._actor, self._critic = networks.learners()
        self.loss = ClipPPOLoss(
            *networks.learners(config.compile),
            clip_epsilon=config.clip_epsilon,
            entropy_bonus=config.entropy_coeff > 0,
            entropy_coeff=config.entropy_coeff,
            critic_coeff=config.critic_coeff,
            loss_critic_type="l2",
            clip_value=config.clip_epsilon if config.clip_value else None,
            normalize_advantage=False,
            log_explained_variance=False,
            # Train the networks in place, so that the collector always has the newest weights.
            functional=False,
        )
        gamma, lmbda = math.exp(-control_step / config.discount_horizon), math.exp(-control_step / config.gae_horizon)
        self._gae = GAE(gamma=gamma, lmbda=lmbda, value_network=None)
        learned = {name: p for name, p in networks.named_parameters() if p.requires_grad}
        self._names, self._parameters = list(learned), list(learned.values())
        self.optimizer = torch.optim.Adam(self._parameters, lr=config.learning_rate, fused=True)
        self._schedule = None
        if config.target_kl is not None:
            self._schedule = KLAdaptiveLR(
                self.optimizer,
                target_kl=config.target_kl,
                min_lr=config.min_learning_rate,
                max_lr=config.max_learning_rate,
            )

    @property
    def learning_rate(self) -> float:
        """Current learning rate."""
        return float(self.optimizer.param_groups[0]["lr"])

    def use_min_learning_rate(self) -> None:
        """Start with the lowest learning rate, if it adapts to the KL; for a training that starts from a policy.

        Adam's first steps have the full size of the learning rate, whatever the gradient. A trained policy, with its
        small standard deviation, would change too much before the KL is measured for the first time.
        """
        if self._schedule is not None:
            for group in self.optimizer.param_groups:
                group["lr"] = self.config.min_learning_rate

    def step_schedules(self, frames: int, total_frames: int) -> None:
        """Set the exploration and the target KL that the settings give for this moment of the training.

        Wide exploration finds the step up, but its noise prevents the robot from learning to stand there.

        Args:
            frames: Number of frames trained so far.
            total_frames: Number of frames of the whole training.
        """
        c = self.config
        if c.final_std is not None:
            first = self.networks.config.max_std
            self.networks.limit_std(_anneal(first, c.final_std, frames / c.std_frames))
        if c.final_target_kl is not None and c.target_kl is not None and self._schedule is not None:
            share = 1 - (total_frames - frames) / (c.kl_anneal_fraction * total_frames)
            self._schedule.target_kl = _anneal(c.target_kl, c.final_target_kl, share)

    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """Update the networks from a batch.

        Args:
            batch: ``[N, T]`` as a TorchRL collector yields it.

        Returns:
            Metrics ``Loss/*`` and ``Policy/mean_std``.

        Raises:
            ConfigError: ``algorithm.compile`` is on, but torch cannot compile on this machine.
            FloatingPointError: The batch is not finite, and nothing has changed; or the loss or the gradient is not
                finite, and the weights are those before that minibatch.
        """
        self._check_finite(batch)
        self.networks.observe(batch)
        inputs = self.networks.prepare(batch)
        with self._autocast():
            self._fill_values(batch, inputs)
        self._gae(batch)
        advantage = batch["advantage"]
        batch["advantage"] = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        flat = inputs.update(batch.select(*LOSS_KEYS)).flatten(0, 1)
        # A few thousand states estimate the KL as well as the whole batch.
        sample = flat.select("actor_input")[:: max(1, len(flat) // KL_STATES)]
        with torch.no_grad(), self._autocast():
            loc, scale = _moments(self._actor.get_dist(sample))
            # The scale is a view of the parameter, which the update changes.
            scale = scale.clone()

        sums: dict[str, Tensor] = {}
        updates = 0
        for _ in range(self.config.epochs):
            # The device of the weights, because a collector's batch has none.
            order = torch.randperm(flat.shape[0], generator=self._generator, device=self._parameters[0].device)
            for rows in order.chunk(self.config.minibatches):
                # index_select copies whole rows, which is faster than indexing.
                part = flat.apply(lambda values, rows=rows: values.index_select(0, rows), batch_size=[len(rows)])
                losses = self._step(part)
                updates += 1
                for name, value in losses.items():
                    sums[name] = sums.get(name, 0.0) + value
        kl = self._divergence(sample, loc, scale)
        if self._schedule is not None:
            # Once per batch. The first minibatches are close to the old policy, so a schedule that steps after each of
            # them raises the rate several times before it can lower it again.
            self._schedule.step(kl)
        return {
            "Loss/surrogate": float(sums["loss_objective"]) / updates,
            "Loss/value_function": float(sums["loss_critic"]) / updates,
            "Loss/entropy": float(sums.get("entropy", torch.zeros(()))) / updates,
            "Loss/clip_fraction": float(sums["clip_fraction"]) / updates,
            "Loss/kl": kl,
            "Loss/learning_rate": self.learning_rate,
            "Policy/mean_std": float(scale.mean()),
        }

    def _check_finite(self, batch: TensorDictBase) -> None:
        """Raise `FloatingPointError` for values that are not finite, which would stay in the normalizers forever."""
        keys = [*self.networks.critic_keys, "action"]
        for key in [("next", "reward"), *keys, *(("next", key) for key in self.networks.critic_keys)]:
            finite = torch.isfinite(batch[key]).flatten(1).all(1)
            if not bool(finite.all()):
                name = key if isinstance(key, str) else ".".join(key)
                raise FloatingPointError(f"{name} is not finite in {int((~finite).sum())} of {len(finite)} worlds")

    def _step(self, part: TensorDictBase) -> dict[str, Tensor]:
        """Take a gradient step on a minibatch, ``[rows]``, and return the losses."""
        try:
            with self._autocast():
                losses = self.loss(part)
        except BackendCompilerFailed as error:
            raise ConfigError(
                f"algorithm.compile=true: torch cannot compile here ({str(error).splitlines()[0]}); install a C++ "
                "compiler or use algorithm.compile=false"
            ) from error
        total = sum(value for name, value in losses.items() if name.startswith("loss_"))
        self.optimizer.zero_grad(set_to_none=True)
        total.backward()
        norm = nn.utils.clip_grad_norm_(self._parameters, self.config.max_grad_norm)
        if not bool(torch.isfinite(norm) & torch.isfinite(total)):
            raise FloatingPointError(f"loss {float(total.detach())} or gradient {float(norm)} is not finite")
        self.optimizer.step()
        return {name: value.detach() for name, value in losses.items()}

    @torch.no_grad()
    def _divergence(self, part: TensorDictBase, loc: Tensor, scale: Tensor) -> float:
        """Return the mean KL divergence between the policies before and after the update.

        Uses the closed form for diagonal Gaussians.

        Args:
            part: ``[rows]`` with ``actor_input``.
            loc: ``[rows, actions]`` means before the update.
            scale: ``[rows, actions]`` standard deviations before the update.
        """
        with self._autocast():
            new_loc, new_scale = _moments(self._actor.get_dist(part))
        ratio = scale / new_scale
        kl = -ratio.log() + 0.5 * (ratio.square() + ((loc - new_loc) / new_scale).square() - 1)
        return float(kl.sum(-1).mean())

    @torch.no_grad()
    def _fill_values(self, batch: TensorDictBase, inputs: TensorDictBase) -> None:
        """Write the values of all states and of their successors into a batch, each computed once.

        The successor of a step is the state of the next step. At a time-out and at the end of the batch it is not, so
        the critic is applied to the true next state.

        Args:
            batch: ``[N, T]``, gets ``state_value`` and ``next/state_value``.
            inputs: ``[N, T]`` with ``critic_input``.
        """
        critic, keys = self.networks.critic, self.networks.critic_keys
        value = self._critic(inputs.select("critic_input"))["state_value"].float()
        following = torch.empty_like(value)
        following[:, :-1] = value[:, 1:]
        recompute = batch["next", "done"] & ~batch["next", "terminated"]
        recompute[:, -1] = True
        recompute = recompute.squeeze(-1)
        following[recompute] = critic(batch["next"].select(*keys)[recompute])["state_value"].float()
        batch["state_value"] = value
        batch["next", "state_value"] = following

    @contextlib.contextmanager
    def _autocast(self) -> Iterator[None]:
        """Use bfloat16 for the matrix products of a ``with`` block, if the settings ask for it."""
        if not self._bf16:
            yield
            return
        with torch.autocast(self._parameters[0].device.type, dtype=torch.bfloat16):
            yield

    def state_dict(self) -> dict[str, Any]:
        """Return the learning rate, and Adam's moments by parameter: ``optimizer/<parameter>/<moment>``."""
        states = self.optimizer.state_dict()["state"]
        return {
            "learning_rate": self.learning_rate,
            "optimizer": {name: dict(states[i]) for i, name in enumerate(self._names) if i in states},
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` returned, or the same with numbers for parameters, as older versions saved it."""
        saved = state["optimizer"]
        groups = self.optimizer.state_dict()["param_groups"]
        groups[0]["lr"] = state["learning_rate"]
        states = {i: saved[key] for i, name in enumerate(self._names) for key in (name, str(i)) if key in saved}
        self.optimizer.load_state_dict({"state": states, "param_groups": groups})
