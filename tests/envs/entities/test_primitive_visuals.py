"""The looks of the robots that have their own, which change neither mass nor contacts."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from dm_control import mjcf

from skatemount.config import compose
from skatemount.envs.entities.quadruped import Quadruped


@pytest.fixture(params=["a1", "a1_isaac", "go2"])
def robot(request: pytest.FixtureRequest) -> Quadruped:
    return Quadruped(config=compose(None, [f"robot={request.param}"]).robot)


def test_visuals_do_not_collide(robot: Quadruped) -> None:
    physics = mjcf.Physics.from_mjcf_model(robot.mjcf_model)
    model = physics.model.ptr
    solid = set(physics.bind(robot.foot_geoms).element_id)
    solid |= {int(physics.bind(geom).element_id) for geoms in robot.body_geoms.values() for geom in geoms}
    visual = [i for i in range(model.ngeom) if i not in solid]
    assert len(visual) > 50
    assert (model.geom_contype[visual] == 0).all() and (model.geom_conaffinity[visual] == 0).all()
    assert (model.geom_contype[sorted(solid)] == 1).all()


def test_every_link_can_be_seen_and_its_mass_is_its_inertials(robot: Quadruped) -> None:
    physics = mjcf.Physics.from_mjcf_model(robot.mjcf_model)
    model = physics.model.ptr
    for body in robot.mjcf_model.find_all("body"):
        i = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, body.full_identifier)
        assert model.body_mass[i] == pytest.approx(body.inertial.mass)
        drawn = (model.geom_bodyid == i) & (model.geom_contype == 0) & (model.geom_rgba[:, 3] > 0)
        assert drawn.any(), body.name


def test_visuals_are_near_the_bodies_that_they_cover(robot: Quadruped) -> None:
    physics = mjcf.Physics.from_mjcf_model(robot.mjcf_model)
    model = physics.model.ptr
    visual = model.geom_contype == 0
    # No part of the trunk or of a link is further than 0.35 m from the origin of its frame.
    assert (np.linalg.norm(model.geom_pos[visual], axis=1) < 0.35).all()


def test_robots_do_not_look_alike() -> None:
    colors = {}
    for name in ("a1", "go2"):
        robot = Quadruped(config=compose(None, [f"robot={name}"]).robot)
        colors[name] = {tuple(material.rgba) for material in robot.mjcf_model.find_all("material")}
    assert len(colors["go2"] - colors["a1"]) >= 4
