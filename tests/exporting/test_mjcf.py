from __future__ import annotations

import exported
import mujoco
import numpy as np
import pytest

from skatemount.envs.scene import SceneIndex
from skatemount.envs.task import MountTask
from skatemount.exporting.mjcf import plain_motors, portable
from skatemount.exporting.starts import array_names, differences


@pytest.fixture(scope="module")
def task() -> MountTask:
    return MountTask(config=exported.policy_config())


@pytest.fixture(scope="module")
def model(task: MountTask) -> mujoco.MjModel:
    return task.scene.compile(visuals=False)


def test_the_scene_compiles_to_the_same_model(task: MountTask, model: mujoco.MjModel) -> None:
    assert len(array_names()) > 300
    assert list(differences(model, mujoco.MjModel.from_xml_string(portable(task.scene.xml())))) == []


def test_plain_motors_are_pd_controllers_with_a_limit(task: MountTask, model: mujoco.MjModel) -> None:
    index = SceneIndex.of(task.scene, model)
    plain = mujoco.MjModel.from_xml_string(plain_motors(portable(task.scene.xml()), model, index))
    assert (plain.actuator_gaintype == mujoco.mjtGain.mjGAIN_FIXED).all()
    robot = task.config.robot
    data = mujoco.MjData(plain)
    random = np.random.default_rng(0)
    data.qpos[index.joint_qpos] = random.uniform(-1, 1, len(index.joint_qpos))
    data.qvel[index.joint_dof] = random.uniform(-5, 5, len(index.joint_dof))
    data.ctrl[index.actuators] = random.uniform(-1, 1, len(index.actuators))
    mujoco.mj_forward(plain, data)
    wanted = (
        robot.kp * (data.ctrl[index.actuators] - data.qpos[index.joint_qpos]) - robot.kd * data.qvel[index.joint_dof]
    )
    limited = np.clip(wanted, -robot.torque_limit, robot.torque_limit)
    assert (limited != wanted).any()
    np.testing.assert_allclose(data.actuator_force[index.actuators], limited)
    # Everything else is the same.
    changed = {name for name, _ in differences(model, plain)}
    assert all(name.startswith("actuator_") for name in changed), changed
