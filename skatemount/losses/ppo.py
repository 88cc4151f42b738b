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
from torchrl.modules import IndependentNormal, set_recurrent_mode
from torchrl.objectives import ClipPPOLoss, KLAdaptiveLR, LossModule
from torchrl.objectives.value import GAE

from skatemount.losses.base import Algorithm
from skatemount.losses.concurrent import ConcurrentCritic
from skatemount.losses.config import AlgorithmConfig
from skatemount.losses.finite import check_finite
from skatemount.losses.imitation import TEACHER_ACTION, imitation_loss
from skatemount.models.base import Networks
from skatemount.utils.devices import torch_threads
from skatemount.utils.errors import ConfigError

KL_STATES = 4096
"""Number of states in which the KL of an update is measured; up to twice as many if it does not divide the batch."""


def _anneal(first: float, last: float, share: float) -> float:
    """Return the value after a share of an exponential fall from the first to the last value."""
    return first * (last / first) ** min(max(share, 0.0), 1.0)


def _moments(distribution: IndependentNormal) -> tuple[Tensor, Tensor]:
    """Return means and standard deviations in float32."""
    normal = distribution.base_dist
    return normal.loc.float(), normal.scale.float()


class PPO(Algorithm):
    """Proximal policy optimization (Schulman et al., 2017).

    Minibatches are of single steps; those of a network with memory are of worlds, each with its whole sequence.

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
        loss_keys: Keys of a batch that the loss reads, in addition to the inputs of the networks.
        optimizer: Adam.
    """

    loss_keys: tuple[str, ...] = ("action", "action_log_prob", "advantage", "value_target", "state_value")

    def __init__(
        self,
        config: AlgorithmConfig,
        networks: Networks,
        control_step: float,
        bf16: bool = False,
        generator: torch.Generator | None = None,
    ):
        super().__init__(config, networks, control_step)
        self._bf16 = bf16
        self._generator = generator
        self._teacher_coeff = config.teacher_coeff
        self._actor, self._critic = networks.learners()
        actor, critic = networks.learners(config.compile)
        self._concurrent: ConcurrentCritic | None = None
        if ConcurrentCritic.supports(actor, critic) and not config.compile:
            critic = self._concurrent = ConcurrentCritic(critic, self._computing)
        self.loss = self.make_loss(actor, critic)
        if not isinstance(self.loss, LossModule):
            raise ConfigError(
                f"algorithm.kind={config.kind}: make_loss of {self._title} returned {type(self.loss).__name__}; it "
                "must return a torchrl.objectives.LossModule"
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

    def make_loss(self, actor: Any, critic: Any) -> LossModule:
        """Return TorchRL's loss; a subclass may return another one.

        The losses are its outputs whose names begin with ``loss_``; all its outputs are logged.

        Args:
            actor: The actor, as `Networks.learners` returns it.
            critic: The critic.
        """
        return ClipPPOLoss(actor, critic, clip_epsilon=self.config.clip_epsilon, **self.loss_options())

    def loss_options(self) -> dict[str, Any]:
        """Return the options that TorchRL's PPO losses have in common, by the settings."""
        c = self.config
        return {
            "entropy_bonus": c.entropy_coeff > 0,
            "entropy_coeff": c.entropy_coeff,
            "critic_coeff": c.critic_coeff,
            "loss_critic_type": "l2",
            "clip_value": c.clip_epsilon if c.clip_value else None,
            "normalize_advantage": False,
            "log_explained_variance": False,
            # Train the networks in place, so that the collector always has the newest weights.
            "functional": False,
        }

    @property
    def _imitating(self) -> bool:
        return self.teacher is not None and self._teacher_coeff > 0

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
            self._set_learning_rate(self.config.min_learning_rate)

    def _set_learning_rate(self, rate: float) -> None:
        for group in self.optimizer.param_groups:
            group["lr"] = rate

    def step_schedules(self, frames: int, total_frames: int) -> None:
        """Set the exploration, the target KL, and the imitation that the settings give for this moment of the training.

        Wide exploration finds the step up, but its noise prevents the robot from learning to stand there.

        Args:
            frames: Number of frames trained so far.
            total_frames: Number of frames of the whole training.
        """
        c = self.config
        taught = max(0.0, 1 - frames / c.teacher_frames)
        self._teacher_coeff = c.teacher_coeff * taught
        if self._schedule is not None and self._imitating:
            # The KL of an imitation is large, and a rate that followed it would be too low to learn from the teacher.
            self._set_learning_rate(max(c.min_learning_rate, c.learning_rate * taught))
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
        with self.ranks.failing_together():
            check_finite(self.networks, batch)
        self.networks.observe(batch)
        # The rounding of a product may depend on torch's threads, so all products of an update have the same number.
        with self._concurrent.two_threads() if self._concurrent is not None else contextlib.nullcontext():
            flat = self._inputs(batch)
            # A few thousand states estimate the KL as well as the whole batch.
            sample = flat.select(*self._actor.in_keys)[:: max(1, flat.numel() * self.ranks.size // KL_STATES)]
            with torch.no_grad(), self._computing():
                loc, scale = _moments(self._actor.get_dist(sample.copy()))
                # The scale is a view of the parameter, which the update changes.
                scale = scale.clone()
            means = self._learn(flat)
            measured = {"Loss/kl": self._divergence(sample, loc, scale), "Policy/mean_std": float(scale.mean())}
        means = self.ranks.averaged(means | measured)
        kl = means["Loss/kl"]
        if self._schedule is not None and not self._imitating:
            # Once per batch. The first minibatches are close to the old policy, so a schedule that steps after each of
            # them raises the rate several times before it can lower it again.
            self._schedule.step(kl)
        return {
            "Loss/surrogate": means["loss_objective"],
            "Loss/value_function": means["loss_critic"],
            "Loss/entropy": means.get("entropy", 0.0),
            **self.loss_metrics(means),
            "Loss/kl": kl,
            "Loss/learning_rate": self.learning_rate,
            "Policy/mean_std": means["Policy/mean_std"],
        }

    def _learn(self, flat: TensorDictBase) -> dict[str, float]:
        """Take the gradient steps of all epochs, and return the losses' means by name.

        Args:
            flat: ``[rows]`` or ``[rows, T]``, what `_inputs` returned.
        """
        sums: dict[str, Tensor] = {}
        updates = 0
        for _ in range(self.config.epochs):
            # The device of the weights, because a collector's batch has none.
            order = torch.randperm(flat.shape[0], generator=self._generator, device=self._parameters[0].device)
            for rows in order.chunk(self.config.minibatches):
                # index_select copies whole rows, which is faster than indexing.
                size = [len(rows), *flat.batch_size[1:]]
                part = flat.apply(lambda values, rows=rows: values.index_select(0, rows), batch_size=size)
                losses = self._step(part)
                updates += 1
                for name, value in losses.items():
                    sums[name] = sums.get(name, 0.0) + value
        return {name: float(value) / updates for name, value in sums.items()}

    def _inputs(self, batch: TensorDictBase) -> TensorDictBase:
        """Return the inputs of learners and loss, with values, advantages and targets.

        Args:
            batch: ``[N, T]``; gets the values and the advantages.

        Returns:
            Rows, which are single steps; or worlds, with all steps of each.
        """
        inputs = self.networks.prepare(batch)
        with self._computing():
            self._fill_values(batch, inputs)
        self._gae(batch)
        advantage = batch["advantage"]
        # Torch splits the sum of a large tensor over its threads, so the rounding would depend on their number.
        with torch_threads(1):
            mean, deviation = self.ranks.mean_and_deviation(advantage)
            batch["advantage"] = (advantage - mean) / (deviation + 1e-8)
        rows = inputs.update(batch.select(*self.loss_keys))
        if self._imitating:
            assert self.teacher is not None
            rows[TEACHER_ACTION] = self.teacher(batch)
        return rows if self.networks.recurrent else rows.flatten(0, 1)

    @property
    def _title(self) -> str:
        return f"{type(self).__name__} of {type(self).__module__}"

    def try_out(self, batch: TensorDictBase) -> None:
        """Compute the loss of a batch, and change nothing; see `Algorithm.try_out`."""
        if self.config.compile:
            # Compiling takes a minute, and again for batches of another size.
            return
        buffers = {name: value.clone() for name, value in self.loss.named_buffers()}
        rows = self._inputs(batch)
        with self._computing():
            _moments(self._actor.get_dist(rows.select(*self._actor.in_keys)))
            losses = self.loss(rows)
        where = f"algorithm.kind={self.config.kind}: the loss of {self._title}"
        if missing := [name for name in ("loss_objective", "loss_critic") if name not in losses.keys()]:
            raise ConfigError(f"{where} gives no {' and no '.join(missing)}, only {', '.join(map(str, losses.keys()))}")
        self.loss_metrics(dict.fromkeys(map(str, losses.keys()), 1.0))
        for name, value in self.loss.named_buffers():
            value.copy_(buffers[name])

    def loss_metrics(self, means: dict[str, float]) -> dict[str, float]:
        """Return the metrics of one's own loss, under ``Loss/*``.

        Args:
            means: Means of the loss's outputs over the minibatches, by name.
        """
        taught = {"Loss/teacher": means["loss_teacher"]} if "loss_teacher" in means else {}
        return {"Loss/clip_fraction": means["clip_fraction"], **taught}

    def _step(self, part: TensorDictBase) -> dict[str, Tensor]:
        """Take a gradient step on a minibatch, ``[rows]``, and return the losses."""
        try:
            if self._concurrent is not None:
                self._concurrent.start(part)
            with self._computing():
                losses = self.loss(part)
                if TEACHER_ACTION in part.keys():
                    moments = _moments(self._actor.get_dist(part.select(*self._actor.in_keys)))
                    losses["loss_teacher"] = self._teacher_coeff * imitation_loss(*moments, part[TEACHER_ACTION])
        except BackendCompilerFailed as error:
            raise ConfigError(
                f"algorithm.compile=true: torch cannot compile here ({str(error).splitlines()[0]}); install a C++ "
                "compiler or use algorithm.compile=false"
            ) from error
        total = sum(value for name, value in losses.items() if name.startswith("loss_"))
        self.optimizer.zero_grad(set_to_none=True)
        total.backward()
        if self._concurrent is not None:
            self._concurrent.join()
        # The loss goes with the gradients, so that all ranks notice one that is not finite.
        total = total.detach()
        self.ranks.mean(total, *(p.grad for p in self._parameters if p.grad is not None))
        norm = nn.utils.clip_grad_norm_(self._parameters, self.config.max_grad_norm)
        if not bool(torch.isfinite(norm) & torch.isfinite(total)):
            raise FloatingPointError(f"loss {float(total)} or gradient {float(norm)} is not finite")
        self.optimizer.step()
        # Some of TorchRL's losses report a value for each row.
        return {name: value.detach().mean() for name, value in losses.items()}

    @torch.no_grad()
    def _divergence(self, part: TensorDictBase, loc: Tensor, scale: Tensor) -> float:
        """Return the mean KL divergence between the policies before and after the update.

        Uses the closed form for diagonal Gaussians.

        Args:
            part: ``[rows]`` or ``[rows, T]``, the actor's inputs.
            loc: ``[rows, actions]`` means before the update.
            scale: ``[rows, actions]`` standard deviations before the update.
        """
        with self._computing():
            new_loc, new_scale = _moments(self._actor.get_dist(part.copy()))
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
            inputs: ``[N, T]``, what the learners read.
        """
        critic, keys = self.networks.critic, self.networks.critic_keys
        value = self._critic(inputs.select(*self._critic.in_keys))["state_value"].float()
        following = torch.empty_like(value)
        following[:, :-1] = value[:, 1:]
        recompute = batch["next", "done"] & ~batch["next", "terminated"]
        recompute[:, -1] = True
        recompute = recompute.squeeze(-1)
        following[recompute] = critic(batch["next"].select(*keys)[recompute])["state_value"].float()
        batch["state_value"] = value
        batch["next", "state_value"] = following

    @contextlib.contextmanager
    def _computing(self) -> Iterator[None]:
        """Use bfloat16 for the matrix products of a ``with`` block, if the settings ask for it, and whole sequences."""
        with contextlib.ExitStack() as stack:
            if self._bf16:
                stack.enter_context(torch.autocast(self._parameters[0].device.type, dtype=torch.bfloat16))
            if self.networks.recurrent:
                stack.enter_context(set_recurrent_mode(True))
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
