from __future__ import annotations

import defaults
import pytest

from skatemount.envs import MountTask
from skatemount.envs.physics import CpuPhysics
from skatemount.envs.physics.factory import make_physics
from skatemount.utils.errors import ConfigError


def test_the_engine_is_chosen_by_its_settings() -> None:
    scene = MountTask(stage="mount").scene
    physics = make_physics(scene, defaults.physics(num_worlds=3, threads=2))
    assert isinstance(physics, CpuPhysics) and (physics.num_worlds, physics.threads) == (3, 2)
    physics.close()
    for settings, named in (
        (defaults.physics(engine="gpu"), r"physics\.engine=gpu must be one of .*cpu"),
        (defaults.physics(num_worlds=0), r"physics\.num_worlds=0"),
        (defaults.physics(threads=-1), r"physics\.threads=-1"),
        (defaults.physics(timestep=0.5), r"physics\.timestep=0\.5"),
        (defaults.physics(solver="Gauss"), r"physics\.solver=Gauss.*Newton"),
    ):
        with pytest.raises(ConfigError, match=named):
            make_physics(scene, settings)
    with pytest.raises(ConfigError, match=r"physics\.num_worlds=-2"):
        make_physics(scene, defaults.physics(), num_worlds=-2)
