"""What a training sets up before it begins: the process, and new networks."""

from __future__ import annotations

import torch

from skatemount.config import TrainConfig
from skatemount.envs.mdp import Mdp
from skatemount.envs.mirror import mirror_map
from skatemount.envs.physics.cpu import available_cores
from skatemount.models import base as models
from skatemount.models.base import Networks
from skatemount.models.symmetry import Reflection
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
