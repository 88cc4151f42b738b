"""Worlds in which the policy does not explore: they show where it gets stuck when it is on its own."""

from __future__ import annotations

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.modules import ProbabilisticActor


class ScoutingActor(TensorDictModuleBase):
    """An actor that takes its mean action in the first few worlds, and explores in the others.

    What happens in the first ones tells nothing of other actions: it is not to be learnt from.

    Args:
        actor: Draws the actions, and writes their means as ``loc``.
        scouts: Worlds in which it does not explore.
    """

    def __init__(self, actor: ProbabilisticActor, scouts: int):
        super().__init__()
        self.actor, self.scouts = actor, scouts
        self.in_keys, self.out_keys = actor.in_keys, actor.out_keys

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Add an action for each world, ``[N, ...]``."""
        acted: TensorDictBase = self.actor(tensordict)
        acted["action"][: self.scouts] = acted["loc"][: self.scouts]
        return acted
