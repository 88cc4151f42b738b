"""The engine's memory of late joint targets, as it must be at the start of an episode."""

from __future__ import annotations

import mujoco
import torch
from torch import Tensor

from skatemount.envs.scene import SceneIndex


def state(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the fields of the state that late targets need in addition; none if no target of the model is late."""
    return ("time", "history") if model.nhistory else ()


def fields(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the field of the model that says how late each target is, s; none if no target of the model is late."""
    return ("actuator_delay",) if model.nhistory else ()


class TargetHistory:
    """Histories in which the targets have always been those of a start state.

    MuJoCo's history of an actuator is a user value, a cursor, the times of the last targets, and the targets. Its
    default has targets of zero, which a world whose targets are late would follow at first.

    Args:
        model: The compiled scene.
        index: Ids of the scene.
        device: Device of the histories.
    """

    def __init__(self, model: mujoco.MjModel, index: SceneIndex, device: torch.device | None = None):
        # The history goes with time 0: its times are the last steps before.
        self._default = torch.as_tensor(mujoco.MjData(model).history, dtype=torch.float64, device=device)
        samples = max(0, int(model.actuator_history[index.actuators[0], 0]))
        addresses = torch.as_tensor(model.actuator_historyadr[index.actuators], dtype=torch.int64, device=device)
        self._targets = addresses.unsqueeze(1) + 2 + samples + torch.arange(samples, device=device)

    def filled(self, targets: Tensor) -> Tensor:
        """Return histories that have always had the given targets.

        Args:
            targets: ``[K, J]`` rad.

        Returns:
            ``[K, H]`` float64.
        """
        history = self._default.repeat(len(targets), 1)
        history[:, self._targets] = targets.double().unsqueeze(-1).expand(-1, -1, self._targets.shape[1])
        return history
