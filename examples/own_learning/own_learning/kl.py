"""PPO with a penalty on the KL divergence in place of the clipped ratio."""

from __future__ import annotations

from typing import Any

from torchrl.objectives import KLPENPPOLoss, LossModule

from skatemount.losses.ppo import PPO


class KlPenaltyPPO(PPO):
    """PPO with an adaptive KL penalty (Schulman et al., 2017, section 4).

    The weight of the penalty doubles after a minibatch whose KL is above the target, and halves after one below it.

    Args:
        target: Target KL divergence between the policies before and after an update.
        weight: Initial weight of the penalty.
    """

    loss_keys = (*PPO.loss_keys, "loc", "scale")

    def __init__(self, *args: Any, target: float = 0.01, weight: float = 1.0, **kwargs: Any):
        self._target, self._weight = target, weight
        super().__init__(*args, **kwargs)

    def make_loss(self, actor: Any, critic: Any) -> LossModule:
        """Return TorchRL's loss."""
        return KLPENPPOLoss(actor, critic, dtarg=self._target, beta=self._weight, **self.loss_options())

    def loss_metrics(self, means: dict[str, float]) -> dict[str, float]:
        """Return the penalized KL and the weight of the penalty."""
        return {"Loss/penalized_kl": means["kl"], "Loss/kl_weight": float(self.loss.beta)}

    def state_dict(self) -> dict[str, Any]:
        """Return the state of PPO and the weight of the penalty."""
        return {**super().state_dict(), "kl_weight": self.loss.beta}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` returned."""
        super().load_state_dict(state)
        self.loss.beta.copy_(state["kl_weight"])
