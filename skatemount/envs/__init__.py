"""The task, its physics and its batched environment."""

from skatemount.envs.mount_env import MountEnv
from skatemount.envs.task import MountTask

__all__ = ["MountEnv", "MountTask"]
