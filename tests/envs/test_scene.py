"""The compiled scene and its index: ids, the layout of the sensors, and the model without visuals."""

from __future__ import annotations

import functools
from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from skatemount.envs import MountEnv, MountTask
from skatemount.envs.scene import Scene, SceneIndex


@functools.cache
def compiled() -> tuple[Scene, mujoco.MjModel, SceneIndex]:
    scene = MountTask(stage="mount").scene
    model = scene.compile(visuals=False)
    return scene, model, SceneIndex.of(scene, model)


def forward() -> tuple[mujoco.MjModel, SceneIndex, mujoco.MjData]:
    _, model, index = compiled()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, index, data


def test_ids_are_those_of_the_parts_that_they_name() -> None:
    _, model, index = compiled()
    assert model.body(index.trunk_body).name == "a1/trunk"
    assert model.body(index.robot_body).name == "a1/"
    assert model.body_parentid[index.trunk_body] == index.robot_body
    assert index.robot_body not in index.robot_bodies and len(index.robot_bodies) == 13
    assert all(model.body(i).name.startswith("a1/") for i in index.robot_bodies)
    assert model.body(index.board_body).name == "board/"
    assert [model.joint(i).name for i in index.truck_joints] == ["board/front_truck", "board/rear_truck"]
    assert model.equality(index.weld).name == "board_fixed"
    assert model.body_mocapid[model.body("robot_floor").id] == index.floor_mocap
    legs = [f"a1/{leg}_{link}" for leg in ("FR", "FL", "RR", "RL") for link in ("hip", "thigh", "calf")]
    assert [model.actuator(i).name for i in index.actuators] == legs
    assert [model.joint(f"{name}_joint").qposadr[0] for name in legs] == index.joint_qpos.tolist()
    assert [model.joint(f"{name}_joint").dofadr[0] for name in legs] == index.joint_dof.tolist()


def test_the_fields_fill_the_sensor_array_without_gaps() -> None:
    _, model, index = compiled()
    slices = sorted((where for where, _ in index.sensors.values()), key=lambda where: where.start)
    assert slices[0].start == 0 and slices[-1].stop == model.nsensordata
    assert all(a.stop == b.start for a, b in zip(slices, slices[1:]))
    for name, (where, shape) in index.sensors.items():
        assert where.stop - where.start == int(np.prod(shape)), name


def test_a_field_reads_the_sensors_of_its_name() -> None:
    model, index, data = forward()

    def field(name: str) -> np.ndarray:
        where, shape = index.sensors[name]
        return data.sensordata[where].reshape(shape)

    np.testing.assert_allclose(field("base_pos"), data.body("a1/trunk").xpos)
    np.testing.assert_allclose(field("base_axes").T, data.body("a1/trunk").xmat.reshape(3, 3), atol=1e-12)
    np.testing.assert_allclose(field("joint_pos"), data.qpos[index.joint_qpos])
    feet = [data.site(f"a1/{leg}_foot").xpos for leg in ("FR", "FL", "RR", "RL")]
    np.testing.assert_allclose(field("foot_pos"), feet)
    np.testing.assert_allclose(field("board_pos"), data.site("board/deck").xpos)


def test_the_rolling_board_moves_at_1_m_per_second_on_wheels_that_do_not_slip() -> None:
    scene, model, index = compiled()
    data = mujoco.MjData(model)
    data.qvel[:] = index.rolling
    mujoco.mj_forward(model, data)
    where, _ = index.sensors["board_lin_vel"]
    assert data.sensordata[where] == pytest.approx([1, 0, 0], abs=1e-9)
    where, _ = index.sensors["wheel_speed"]
    assert data.sensordata[where] * scene.board.config.wheel_radius == pytest.approx([1] * 4)
    for geom in scene.board.wheel_geoms:
        # The point of a wheel that touches the floor stands still.
        touch = data.geom(geom.full_identifier).xpos - (0, 0, scene.board.config.wheel_radius)
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, jacobian, None, touch, model.geom(geom.full_identifier).bodyid[0])
        np.testing.assert_allclose(jacobian @ data.qvel, 0, atol=1e-9)


def test_the_friction_that_the_robot_feels_is_of_its_own_geoms_the_deck_and_its_floor() -> None:
    _, model, index = compiled()
    of_robot = {int(i) for i in np.flatnonzero(np.isin(model.geom_bodyid, index.robot_bodies))}
    others = {model.geom(i).name for i in set(index.touched_geoms.tolist()) - of_robot}
    assert of_robot < set(index.touched_geoms.tolist()) and others == {"board/deck", "robot_ground"}


def test_robot_and_board_do_not_overlap_in_the_models_own_start_state() -> None:
    model, index, data = forward()
    pairs = [{model.body(model.geom_bodyid[geom]).name for geom in contact.geom} for contact in data.contact]
    of_board = [pair for pair in pairs if any(name.startswith("board/") for name in pair)]
    assert len(of_board) == 4 and all("world" in pair for pair in of_board)  # the wheels on the floor
    assert all("robot_floor" in pair for pair in pairs if pair not in of_board)


def test_a_model_without_visuals_computes_the_same() -> None:
    scene, plain, index = compiled()
    full = scene.compile()
    assert full.ngeom > plain.ngeom + 50 and full.nmesh > plain.nmesh
    results = []
    for model in (plain, full):
        data = mujoco.MjData(model)
        data.qpos[2:3] -= 0.1
        data.ctrl[index.actuators] = 0.3
        mujoco.mj_step(model, data, nstep=20)
        results.append((data.qpos.copy(), data.sensordata.copy()))
    for a, b in zip(*results):
        np.testing.assert_array_equal(a, b)


def test_a_foot_touches_with_the_impedance_of_the_settings(make_env: Callable[..., MountEnv]) -> None:
    env = make_env("balance", 2, ["physics.foot_impedance=[0.6,0.7]"])
    env.rollout(5)
    model, data = env.physics.render_data(0)
    mujoco.mj_forward(model, data)
    feet = {model.geom(geom.full_identifier).id for geom in env.task.scene.robot.foot_geoms}
    touching = [contact for contact in data.contact if {contact.geom1, contact.geom2} & feet]
    assert touching and all(contact.solimp[:3] == pytest.approx([0.6, 0.7, 0.001], rel=1e-3) for contact in touching)
