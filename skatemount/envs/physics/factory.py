"""The choice of a physics engine by the settings."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from skatemount.envs.config.physics import PhysicsConfig
from skatemount.envs.physics.base import Physics
from skatemount.envs.scene import Scene
from skatemount.utils.errors import ConfigError


def _cpu(scene: Scene, config: PhysicsConfig) -> Physics:
    from skatemount.envs.physics.cpu import CpuPhysics

    if config.device not in ("auto", "cpu"):
        raise ConfigError(f"physics.device={config.device} goes with physics.engine=warp, but physics.engine is cpu")
    return CpuPhysics(scene, config.num_worlds, config.threads)


def _warp(scene: Scene, config: PhysicsConfig) -> Physics:
    try:
        import warp

        # Set before anything else of Warp is used, because it prints a line for every device and module that it loads.
        warp.config.log_level = warp.LOG_WARNING
        from skatemount.envs.physics.warp import WarpPhysics
    except ImportError as error:
        raise ConfigError(
            f"physics.engine=warp needs mujoco-warp and warp-lang ({error}): pip install 'skatemount[warp]'"
        ) from error
    return WarpPhysics(scene, config.num_worlds, config.device, config.max_contacts, config.max_constraints)


_MAKERS: dict[str, Callable[[Scene, PhysicsConfig], Physics]] = {"cpu": _cpu, "warp": _warp}


def make_physics(
    scene: Scene, config: PhysicsConfig, num_worlds: int | None = None, threads: int | None = None
) -> Physics:
    """Start the engine that the settings name.

    Args:
        scene: The scene, which the engine compiles.
        config: Settings of the engine.
        num_worlds: Number of worlds; that of the settings if None.
        threads: Number of physics threads; that of the settings if None.

    Returns:
        The engine.

    Raises:
        ConfigError: A setting cannot be used, or the engine is not installed.
    """
    config = dataclasses.replace(config)
    config.num_worlds = config.num_worlds if num_worlds is None else num_worlds
    config.threads = config.threads if threads is None else threads
    config.validate()
    return _MAKERS[config.engine](scene, config)
