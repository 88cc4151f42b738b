"""Engines that step a batch of worlds."""

from skatemount.envs.physics.base import Physics, make_physics
from skatemount.envs.physics.cpu import CpuPhysics

__all__ = ["CpuPhysics", "Physics", "make_physics"]
