"""Policies that a session can play: trained ones, and those that do nothing or act at random."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from tensordict import TensorDictBase

from skatemount.envs.mount_env import MountEnv
from skatemount.runs.checkpoint import list_checkpoints
from skatemount.runs.find import runs_with_checkpoints
from skatemount.runs.folder import RunFolder
from skatemount.runs.shipped import shipped_policies
from skatemount.utils.errors import ConfigError

MANY = 20
"""Number of runs, and of checkpoints of a run, that are offered."""


@dataclass
class ZeroPolicy:
    """A policy that always takes the action zero: the joints' targets are the default pose."""

    def actor_in(self, env: MountEnv) -> Callable[[TensorDictBase], TensorDictBase]:
        """Return the actor; see `skatemount.agents.policy.Policy`."""
        zero = torch.zeros(env.action_spec.shape, device=env.device)
        return lambda state: state.set("action", zero)


@dataclass
class RandomPolicy:
    """A policy whose actions are uniform within -1 and 1.

    Attributes:
        seed: Seed of the actions.
    """

    seed: int = 0

    def actor_in(self, env: MountEnv) -> Callable[[TensorDictBase], TensorDictBase]:
        """Return the actor; see `skatemount.agents.policy.Policy`."""
        generator = torch.Generator(env.device).manual_seed(self.seed)

        def act(state: TensorDictBase) -> TensorDictBase:
            drawn = torch.rand(env.action_spec.shape, generator=generator, device=env.device)
            return state.set("action", 2 * drawn - 1)

        return act


SIMPLE = {"zero": ZeroPolicy, "random": RandomPolicy}
"""Policies without weights, by the name that chooses them."""


def known_policies(root: Path | str) -> list[str]:
    """Return what can be chosen as a policy: those without weights, the shipped ones, and the newest runs.

    Args:
        root: Folder of all runs.
    """
    runs = [str(run) for run in itertools.islice(runs_with_checkpoints(Path(root)), MANY)]
    return [*SIMPLE, *shipped_policies(), *runs]


def checkpoints_of(policy: Path) -> list[str]:
    """Return the checkpoints of the run that a policy is of, the newest first; none for a policy without a run.

    Args:
        policy: A checkpoint, a run, or a policy's file.
    """
    try:
        run = RunFolder.open(policy)
    except ConfigError:
        return []
    folders = [part.path for part in run.parts] or [run.path]
    found = [each for folder in folders for each in list_checkpoints(folder / "checkpoints")]
    return [str(each) for each in reversed(found)][:MANY]
