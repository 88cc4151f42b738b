"""The networks of a policy as a graph: normalizer, mean action and joint targets."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor, nn
from torchrl.envs.utils import ExplorationType, set_exploration_type

from skatemount.envs.robots.layout import JointLayout
from skatemount.envs.task import MountTask
from skatemount.exporting.onnx_graph import Values, make_graph
from skatemount.models.activations import ELU
from skatemount.models.base import Networks
from skatemount.utils.errors import ConfigError


class PolicyFunction(nn.Module):
    """A policy as a function from observations to actions and joint targets.

    Args:
        networks: Actor and critic.
        task: The task, for the meaning of the actions.

    Raises:
        ConfigError: The actor has a memory, or reads something other than ``observation``.
    """

    def __init__(self, networks: Networks, task: MountTask):
        super().__init__()
        kind = f"network.kind={networks.config.kind}"
        if networks.recurrent:
            raise ConfigError(f"{kind} has a memory and cannot be exported; use one without, such as mlp")
        if list(networks.actor_keys) != ["observation"]:
            raise ConfigError(f"{kind}: its actor reads {', '.join(networks.actor_keys)}; a robot has observation only")
        # A copy without gradients, because weights become constants of the graph.
        self._actor = copy.deepcopy(networks.actor).cpu().requires_grad_(False).eval()
        for parent in list(self._actor.modules()):
            for name, child in parent.named_children():
                if isinstance(child, ELU):
                    # Ours writes into its result, which a graph cannot; they differ by 1e-7.
                    setattr(parent, name, nn.ELU())
        robot = task.scene.robot
        self._clip = float(robot.config.action_clip)
        pose, scale = (torch.as_tensor(each, dtype=torch.float32) for each in (robot.default_pose, robot.action_scale))
        self.register_buffer("pose", pose)
        self.register_buffer("scale", scale)
        self.size, self.layout = networks.sizes[0], robot.layout

    size: int
    layout: JointLayout
    pose: Tensor
    scale: Tensor

    def forward(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        """Return the mean actions and the joint targets.

        Args:
            observation: ``[N, D]``.

        Returns:
            ``[N, J]``, and ``[N, J]`` rad: default pose + scale x clipped action.
        """
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            action = self._actor(TensorDict({"observation": observation}, batch_size=[]))["action"]
        return action, self.pose + self.scale * action.clamp(-self._clip, self._clip)


def policy_graph(function: PolicyFunction) -> Any:
    """Return the graph of a policy, ``onnx.ModelProto``, for any number of observations at a time."""

    def named(values: Values) -> Values:
        action, targets = function(values["observation"])
        return {"action": action, "targets": targets}

    names = ("observation", "action", "targets")
    # Two rows, because the tracer would take a size of 1 for one that every batch has.
    return make_graph(named, {"observation": torch.zeros(2, function.size)}, batch=names)


def write_torch(function: PolicyFunction, path: Path) -> None:
    """Write a policy as a program of ``torch.export``, which loads without this package.

    Args:
        function: The policy.
        path: File to write, ``.pt2``.
    """
    batch = torch.export.Dim("batch", min=1)
    program = torch.export.export(
        function, (torch.zeros(2, function.size),), dynamic_shapes=({0: batch},), strict=False
    )
    torch.export.save(program, path)
