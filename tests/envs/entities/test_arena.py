from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
from dm_control import mjcf

from skatemount.envs.entities.arena import MountArena
from skatemount.utils.errors import ConfigError


def drop(arena: MountArena, contype: int, conaffinity: int, physics_steps: int = 400):
    """Drops a ball with the given contact bits and says at what height it rests."""
    frame = arena.mjcf_model.worldbody.add("body", pos=(0.5, 0, 0.2))
    frame.add("freejoint")
    frame.add(
        "geom",
        type="sphere",
        size=(0.05,),
        mass=1.0,
        contype=contype,
        conaffinity=conaffinity,
    )
    arena.mjcf_model.option.timestep = 0.005
    physics = mjcf.Physics.from_mjcf_model(arena.mjcf_model)

    def settle(raised: float) -> float:
        physics.reset()
        physics.bind(arena.robot_floor).mocap_pos = (0, 0, raised)
        for _ in range(physics_steps):
            physics.step()
        return float(physics.bind(frame).xpos[2]) - 0.05

    return settle


def test_raising_the_robots_ground_lifts_the_robot_and_not_the_board() -> None:
    robot = drop(MountArena(), contype=1, conaffinity=0)
    assert robot(0.0) == pytest.approx(0.0, abs=2e-3)
    assert robot(0.05) == pytest.approx(0.05, abs=2e-3)
    board = drop(MountArena(), contype=2, conaffinity=1)
    assert board(0.0) == pytest.approx(0.0, abs=2e-3)
    assert board(0.05) == pytest.approx(0.0, abs=2e-3)


def test_friction_is_a_parameter() -> None:
    physics = mjcf.Physics.from_mjcf_model((arena := MountArena(floor_friction=0.6)).mjcf_model)
    for plane in (arena.floor, arena.robot_ground):
        assert physics.bind(plane).friction[0] == pytest.approx(0.6)
        assert physics.bind(plane).type == mujoco.mjtGeom.mjGEOM_PLANE


@pytest.mark.parametrize("friction", [0.0, -0.5, math.nan, math.inf])
def test_bad_friction_is_refused(friction: float) -> None:
    with pytest.raises(ConfigError, match="floor_friction"):
        MountArena(floor_friction=friction)


def test_no_noslip_pass_is_asked_for() -> None:
    model = mjcf.Physics.from_mjcf_model(MountArena().mjcf_model).model
    assert model.opt.noslip_iterations == 0


def test_the_robots_ground_is_invisible_and_images_may_be_large() -> None:
    arena = MountArena()
    physics = mjcf.Physics.from_mjcf_model(arena.mjcf_model)
    assert physics.bind(arena.robot_ground).rgba[3] == 0
    assert physics.model.vis.global_.offwidth >= 1280
    assert physics.model.vis.global_.offheight >= 960


def test_the_cameras_look_at_the_board() -> None:
    physics = mjcf.Physics.from_mjcf_model(MountArena().mjcf_model)
    names = [physics.model.id2name(i, "camera") for i in range(physics.model.ncam)]
    assert names == ["side", "top"]
    for position, frame in zip(physics.data.cam_xpos, physics.data.cam_xmat, strict=True):
        towards = -frame.reshape(3, 3)[:, 2]
        to_board = np.array([0, 0, 0.1]) - position
        cosine = towards @ to_board / np.linalg.norm(to_board)
        assert cosine > math.cos(math.radians(8))
