"""The looks of a robot that has none of its own, which change neither its mass nor its contacts."""

from __future__ import annotations

import defaults
import numpy as np
import pytest
from dm_control import mjcf
from made_up_robot import SPEC

from skatemount.envs.entities.quadruped import Quadruped
from skatemount.envs.robots import ROBOTS


def test_every_shape_can_be_seen_where_it_collides(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(ROBOTS, "beetle", SPEC)
    robot = Quadruped(config=defaults.robot(variant="beetle"))
    model = mjcf.Physics.from_mjcf_model(robot.mjcf_model).model
    solid = model.geom_contype != 0
    assert solid.sum() == (~solid).sum() == 1 + 3 * 4 + 4
    for field in (model.geom_bodyid, model.geom_type, model.geom_size, model.geom_pos, model.geom_quat):
        rows = [np.column_stack([model.geom_bodyid, field])[mask] for mask in (solid, ~solid)]
        np.testing.assert_allclose(*(each[np.argsort(each[:, 0], kind="stable")] for each in rows))
    assert (model.geom_group[~solid] == 2).all()
    assert model.body_mass.sum() == pytest.approx(5 + 4 * 1.9)
