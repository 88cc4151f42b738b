"""The task, its physics and its batched environment."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from skatemount.envs.mount_env import MountEnv
    from skatemount.envs.task import MountTask

__all__ = ["MountEnv", "MountTask"]


def __getattr__(name: str) -> Any:
    # Settings lie below this package and are checked without torch and MuJoCo, which the classes need.
    if name == "MountEnv":
        from skatemount.envs.mount_env import MountEnv

        return MountEnv
    if name == "MountTask":
        from skatemount.envs.task import MountTask

        return MountTask
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
