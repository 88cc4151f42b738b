"""Physics engines that step a batch of worlds."""

from skatemount.envs.physics.base import Physics
from skatemount.envs.physics.cpu import CpuPhysics
from skatemount.envs.physics.factory import make_physics

__all__ = ["CpuPhysics", "Physics", "make_physics"]
