"""Settings of one group for tests: the values of a YAML file, with some of them changed."""

from __future__ import annotations

import copy
import dataclasses
import functools
from typing import Any

from skatemount.config import TrainConfig, compose
from skatemount.curriculum.config import CurriculumConfig
from skatemount.envs.config.board import SkateboardConfig
from skatemount.envs.config.commands import CommandConfig
from skatemount.envs.config.physics import PhysicsConfig
from skatemount.envs.config.randomization import RandomizationConfig
from skatemount.envs.config.robot import RobotConfig
from skatemount.envs.config.starts import StartConfig
from skatemount.envs.robots import A1, JointLayout
from skatemount.losses.config import AlgorithmConfig
from skatemount.models.config import NetworkConfig

LAYOUT = JointLayout.of(A1)
"""Order of the A1's joints, feet and bodies."""


@functools.cache
def _composed() -> TrainConfig:
    return compose("mount", ["curriculum=none", "curriculum.free_board_after=0.3", "randomization=none"])


def _part(name: str, changes: dict[str, Any]) -> Any:
    return dataclasses.replace(copy.deepcopy(getattr(_composed(), name)), **changes)


def robot(**changes: Any) -> RobotConfig:
    """Return the settings of the A1."""
    return _part("robot", changes)


def board(**changes: Any) -> SkateboardConfig:
    """Return the settings of the default board."""
    return _part("board", changes)


def physics(**changes: Any) -> PhysicsConfig:
    """Return the settings of the CPU engine."""
    return _part("physics", changes)


def start(**changes: Any) -> StartConfig:
    """Return the start states of the stage mount."""
    return _part("start", changes)


def command(**changes: Any) -> CommandConfig:
    """Return the command toward the board."""
    return _part("command", changes)


def randomization(**changes: Any) -> RandomizationConfig:
    """Return no randomization, but for the changes."""
    return _part("randomization", changes)


def network(**changes: Any) -> NetworkConfig:
    """Return a network without symmetry that explores more widely than the default one."""
    return _part("network", {"symmetric": False, "init_std": 0.5, "max_std": 1.0} | changes)


def algorithm(**changes: Any) -> AlgorithmConfig:
    """Return the default hyper-parameters of PPO."""
    return _part("algorithm", changes)


def curriculum(**changes: Any) -> CurriculumConfig:
    """Return a curriculum's settings; kind ``none`` unless changed."""
    return _part("curriculum", changes)
