"""The task, its physics engines and its batched environment."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from skatemount.envs.mount_env import MountEnv
    from skatemount.envs.task import MountTask

__all__ = ["MountEnv", "MountTask"]


def __getattr__(name: str) -> Any:
    # The classes need torch and MuJoCo. The settings in this package must be importable without them.
    if name == "MountEnv":
        from skatemount.envs.mount_env import MountEnv

        return MountEnv
    if name == "MountTask":
        from skatemount.envs.task import MountTask

        return MountTask
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
