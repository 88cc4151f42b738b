"""Set-up of a training: the process, new networks, and the initial policy."""

from __future__ import annotations

from typing import Any

import torch

from skatemount.agents.teacher import Teacher
from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.agents.transfer import load_pretrained
from skatemount.config import TrainConfig
from skatemount.envs import MountTask
from skatemount.envs.mdp import Mdp
from skatemount.envs.mirror import mirror_map
from skatemount.models import base as models
from skatemount.models.base import Networks
from skatemount.models.symmetry import Reflection
from skatemount.utils.cores import available_cores
from skatemount.utils.memory import disable_malloc_trim


def set_up_process(config: TrainConfig) -> None:
    """Set torch's threads and matrix precision, and the memory allocator, for this process."""
    # Physics and torch take turns, so both may use every core.
    disable_malloc_trim()
    torch.set_num_threads(config.torch_threads or available_cores())
    torch.set_float32_matmul_precision("highest" if config.precision == "highest" else "medium")


def make_networks(config: TrainConfig, mdp: Mdp) -> Networks:
    """Return untrained networks for the observations and actions of a task."""
    observation, privileged, layout = mdp.observation, mdp.privileged, mdp.context.layout
    reflections = None
    if config.network.symmetric:
        images = observation.mirror(), privileged.mirror(), mirror_map("joints", layout.num_joints, layout)
        reflections = Reflection(*images[0]), Reflection(*images[1]), Reflection(*images[2])
    return models.make_networks(config.network, observation.size, privileged.size, layout.num_joints, reflections)


def load_initial_policy(
    config: TrainConfig, networks: Networks, task: MountTask
) -> tuple[str | None, dict[str, Any] | None]:
    """Load the policy that the settings name into new networks.

    Args:
        config: Every setting.
        networks: The networks; those of the policy if one is named.
        task: The task of the training.

    Returns:
        The policy's name for the user, and its provenance for the run folder; both None to train from scratch.

    Raises:
        ConfigError: There is no such policy, or it does not fit.
    """
    spec = config.stage.init_from if config.init_from == "stage" else config.init_from
    if spec is None:
        return None, None
    agent = TrainedPolicy.load(spec, config.logger.root, "init_from")
    where = f"init_from={spec}"
    load_pretrained(networks, agent, task, config.init_from_expand, where, config.init_from_other_robot)
    # This run sets how widely to explore: a policy that learned to walk explores too much for standing.
    networks.limit_std(config.network.max_std)
    card = agent.card
    parent = {"init_from": spec, "policy": agent.spec, "frames": card.frames, "sha256": card.sha256}
    return spec if spec == agent.spec else f"{spec} ({agent.spec})", parent


def load_teacher(config: TrainConfig, task: MountTask, device: torch.device) -> Teacher | None:
    """Load the policy that a training imitates to a device; None without ``algorithm.teacher``.

    ``algorithm.teacher`` of the settings becomes the name that loads the same policy again.

    Raises:
        ConfigError: There is no such policy, or the task lacks what it reads.
    """
    if (spec := config.algorithm.teacher) is None:
        return None
    agent = TrainedPolicy.load(spec, config.logger.root, "algorithm.teacher")
    agent.to(device)
    config.algorithm.teacher = agent.spec
    return Teacher(agent, task, f"algorithm.teacher={spec}")
