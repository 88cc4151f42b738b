"""PPO: TorchRL's `ClipPPOLoss` and `GAE`, with exact bootstrap at time-outs and a learning rate that follows the KL."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator

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

LEARNT_FROM = ("action", "action_log_prob", "advantage", "value_target", "state_value")
"""What the loss needs of a batch, besides what the networks see."""

KL_STATES = 4096
"""States that the KL of an update is measured in; up to twice as many if the batch is no multiple of it."""


def _fallen(first: float, last: float, share: float) -> float:
    """Where something is that falls from the first to the last value by the same factor in each step."""
    return first * (last / first) ** min(max(share, 0.0), 1.0)


def _moments(distribution: IndependentNormal) -> tuple[Tensor, Tensor]:
    normal = distribution.base_dist
    return normal.loc.float(), normal.scale.float()


class PPO:
    """Updates an `ActorCritic` from batches of experience.

    Args:
        config: Hyper-parameters.
        networks: Actor and critic.
        control_step: Seconds between two actions.
        bf16: Compute the updates' matrix products in bfloat16.
        generator: Source of the minibatches' order.
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
            # The networks are trained in place, so that what collects always has the newest weights.
            functional=False,
        )
        gamma, lmbda = math.exp(-control_step / config.discount_horizon), math.exp(-control_step / config.gae_horizon)
        self._gae = GAE(gamma=gamma, lmbda=lmbda, value_network=None)
        self._parameters = [p for p in networks.parameters() if p.requires_grad]
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
        """The present learning rate."""
        return float(self.optimizer.param_groups[0]["lr"])

    def use_min_learning_rate(self) -> None:
        """Begin at the lowest learning rate, if it follows the KL: for a policy that can already do something.

        Adam's first steps are of full size whatever the gradient, and a trained policy with its small deviation
        would be far from itself before the KL is first looked at.
        """
        if self._schedule is not None:
            for group in self.optimizer.param_groups:
                group["lr"] = self.config.min_learning_rate

    def step_schedules(self, frames: int, total_frames: int) -> None:
        """Narrow exploration, and make the steps smaller, as the settings say for this moment.

        Exploring finds the step up, and hides whether the robot can stand there.

        Args:
            frames: Trained so far.
            total_frames: To train in all.
        """
        c = self.config
        if c.final_std is not None:
            first = self.networks.config.max_std
            self.networks.limit_std(_fallen(first, c.final_std, frames / c.std_frames))
        if c.final_target_kl is not None and c.target_kl is not None and self._schedule is not None:
            share = 1 - (total_frames - frames) / (c.kl_anneal_fraction * total_frames)
            self._schedule.target_kl = _fallen(c.target_kl, c.final_target_kl, share)

    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """Learn from a batch.

        Args:
            batch: ``[N, T]`` as a TorchRL collector yields it.

        Returns:
            ``Loss/*`` and ``Policy/mean_std``.

        Raises:
            ConfigError: ``algorithm.compile`` is on, and torch cannot compile here.
            FloatingPointError: The batch is not finite, and nothing has changed; or the loss or the gradient is not,
                and the weights are as before that minibatch.
        """
        self._check_finite(batch)
        self.networks.observe(batch)
        seen = self.networks.prepare(batch)
        with self._autocast():
            self._fill_values(batch, seen)
        self._gae(batch)
        advantage = batch["advantage"]
        batch["advantage"] = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        flat = seen.update(batch.select(*LEARNT_FROM)).flatten(0, 1)
        # What the whole batch would tell about the KL, some thousand states tell as well.
        some = flat.select("actor_input")[:: max(1, len(flat) // KL_STATES)]
        with torch.no_grad(), self._autocast():
            loc, scale = _moments(self._actor.get_dist(some))
            # The scale is a view of the parameter that is about to change.
            scale = scale.clone()

        sums: dict[str, Tensor] = {}
        updates = 0
        for _ in range(self.config.epochs):
            # A collector's batch names no device, which would mean the CPU.
            order = torch.randperm(flat.shape[0], generator=self._generator, device=self._parameters[0].device)
            for rows in order.chunk(self.config.minibatches):
                # Whole rows are copied; an index would go through their numbers one by one.
                part = flat.apply(lambda values, rows=rows: values.index_select(0, rows), batch_size=[len(rows)])
                losses = self._step(part)
                updates += 1
                for name, value in losses.items():
                    sums[name] = sums.get(name, 0.0) + value
        kl = self._divergence(some, loc, scale)
        if self._schedule is not None:
            # Once a batch: near the old policy the first minibatches move little at any rate, and a rate that grows
            # meanwhile overshoots several times over before it is cut again.
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
        # Before the normalisers see it: they would never forget it.
        seen = [*self.networks.critic_keys, "action"]
        for key in [("next", "reward"), *seen, *(("next", key) for key in self.networks.critic_keys)]:
            finite = torch.isfinite(batch[key]).flatten(1).all(1)
            if not bool(finite.all()):
                name = key if isinstance(key, str) else ".".join(key)
                raise FloatingPointError(f"{name} is not finite in {int((~finite).sum())} of {len(finite)} worlds")

    def _step(self, part: TensorDictBase) -> dict[str, Tensor]:
        try:
            with self._autocast():
                losses = self.loss(part)
        except BackendCompilerFailed as error:
            raise ConfigError(
                f"algorithm.compile=true: torch cannot compile here ({str(error).splitlines()[0]}); install a C++ "
                "compiler, or algorithm.compile=false"
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
        """KL of the policy before the iteration from the present one, the closed form for diagonal Gaussians."""
        with self._autocast():
            new_loc, new_scale = _moments(self._actor.get_dist(part))
        ratio = scale / new_scale
        kl = -ratio.log() + 0.5 * (ratio.square() + ((loc - new_loc) / new_scale).square() - 1)
        return float(kl.sum(-1).mean())

    @torch.no_grad()
    def _fill_values(self, batch: TensorDictBase, seen: TensorDictBase) -> None:
        """Value of every state and of what follows it, each computed once.

        What follows a step is the next step's state, but at a time-out and at the end of the batch: there the critic
        looks at the true next state.
        """
        critic, keys = self.networks.critic, self.networks.critic_keys
        value = self._critic(seen.select("critic_input"))["state_value"].float()
        following = torch.empty_like(value)
        following[:, :-1] = value[:, 1:]
        look = batch["next", "done"] & ~batch["next", "terminated"]
        look[:, -1] = True
        look = look.squeeze(-1)
        following[look] = critic(batch["next"].select(*keys)[look])["state_value"].float()
        batch["state_value"] = value
        batch["next", "state_value"] = following

    @contextlib.contextmanager
    def _autocast(self) -> Iterator[None]:
        if not self._bf16:
            yield
            return
        with torch.autocast(self._parameters[0].device.type, dtype=torch.bfloat16):
            yield

    def state_dict(self) -> dict[str, object]:
        """Optimiser and learning rate."""
        return {"optimizer": self.optimizer.state_dict()}

    def load_state_dict(self, state: dict[str, dict]) -> None:
        """Restore what `state_dict` returned."""
        self.optimizer.load_state_dict(state["optimizer"])
