from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import defaults
import mujoco
import numpy as np
import pytest
from dm_control import composer, mjcf
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from skatemount.envs.config.robot import RobotConfig
from skatemount.envs.entities.quadruped import KD_INDEX, KP_INDEX, Quadruped, scale_gains
from skatemount.envs.robots.a1 import LEGS, calf_inertial, leg_signs
from skatemount.utils.errors import ConfigError

VARIANTS = ("a1", "a1_isaac")
TORQUE, SPEED = 33.5, 21.0


@pytest.fixture(scope="module", params=VARIANTS)
def robot(request):
    return Quadruped(defaults.robot(variant=request.param))


@pytest.fixture(scope="module")
def held():
    """An A1 whose trunk is held by the world, with its physics."""
    entity = Quadruped(defaults.robot())
    return entity, mjcf.Physics.from_mjcf_model(entity.mjcf_model)


@pytest.fixture(scope="module")
def standing():
    """An A1 free to move on a floor, after two seconds at its default pose."""
    entity, arena = Quadruped(defaults.robot()), composer.Arena()
    arena.mjcf_model.worldbody.add("geom", name="floor", type="plane", size=(2, 2, 0.1), contype=0, conaffinity=1)
    frame = arena.add_free_entity(entity)
    physics = mjcf.Physics.from_mjcf_model(arena.mjcf_model)
    physics.model.opt.timestep = 0.005
    with physics.reset_context():
        entity.set_pose(physics, position=(0, 0, 0.325))
        physics.bind(entity.joints).qpos = entity.default_pose
    physics.bind(entity.actuators).ctrl = entity.default_pose
    physics.step(400)
    return entity, frame, physics


def motor_law(target, q, v, kp=35.0, kd=0.7):
    """Controller limited by stall torque and torque-speed line, as in Isaac Lab's DC motor."""
    low = np.clip(TORQUE * (-1 - v / SPEED), -TORQUE, 0)
    high = np.clip(TORQUE * (1 - v / SPEED), 0, TORQUE)
    return np.clip(kp * (target - q) - kd * v, low, high)


def actuator_force(entity, physics, target, q, v):
    with physics.reset_context():
        physics.bind(entity.joints).qpos = q
        physics.bind(entity.joints).qvel = v
    # The context leaves with the actuators off.
    physics.bind(entity.actuators).ctrl = target
    physics.forward()
    return np.array(physics.bind(entity.actuators).force)


@pytest.mark.parametrize(("variant", "mass"), [("a1", 12.453), ("a1_isaac", 13.741)])
def test_total_mass(variant, mass):
    entity = Quadruped(defaults.robot(variant=variant))
    physics = mjcf.Physics.from_mjcf_model(entity.mjcf_model)
    assert physics.model.body_mass.sum() == pytest.approx(mass, abs=1e-9)


def test_robot_is_mirror_symmetric(robot):
    """Reflecting y maps the left legs on the right ones: mass centers and inertias agree."""
    physics = mjcf.Physics.from_mjcf_model(robot.mjcf_model)
    flip = np.diag([1.0, -1.0, 1.0])
    for end in "FR":
        for link in ("hip", "thigh", "calf"):
            sides = []
            for side in "RL":
                body = physics.bind(robot.mjcf_model.find("body", f"{end}{side}_{link}"))
                rotation = np.array(body.ximat).reshape(3, 3)
                inertia = rotation @ np.diag(body.inertia) @ rotation.T
                sides.append((np.array(body.xipos), inertia))
            (right, right_inertia), (left, left_inertia) = sides
            np.testing.assert_allclose(left, flip @ right, atol=1e-12)
            np.testing.assert_allclose(left_inertia, flip @ right_inertia @ flip, atol=1e-9)


def test_hip_inertials_of_front_and_rear_are_reflections():
    entity = Quadruped(defaults.robot())
    front, rear = (entity.mjcf_model.find("body", name).inertial for name in ("FR_hip", "RR_hip"))
    np.testing.assert_allclose(front.pos, [-0.003311, -0.000635, 3.1e-5])
    np.testing.assert_allclose(rear.pos, [0.003311, -0.000635, 3.1e-5])
    np.testing.assert_allclose(front.fullinertia[3:], [9.409e-6, -3.42e-7, 4.66e-7])
    np.testing.assert_allclose(rear.fullinertia[3:], [-9.409e-6, 3.42e-7, 4.66e-7])


def test_merged_calf_and_foot_match_the_published_link():
    merged = calf_inertial()
    assert merged.mass == pytest.approx(0.226)
    np.testing.assert_allclose(merged.com, [0.00472659, 0, -0.131975], atol=1e-6)
    principal = np.sort(np.linalg.eigvalsh(merged.inertia))
    np.testing.assert_allclose(principal, [3.54834e-5, 0.00339393, 0.00340344], rtol=1e-3)


def test_foot_positions_follow_the_stated_kinematics(robot):
    def rx(a):
        return np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])

    def ry(a):
        return np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])

    kin = robot.kinematics
    physics = mjcf.Physics.from_mjcf_model(robot.mjcf_model)
    rng = np.random.default_rng(0)
    for _ in range(20):
        q = rng.uniform(*robot.joint_range.T)
        with physics.reset_context():
            physics.bind(robot.joints).qpos = q
        for i, leg in enumerate(LEGS):
            front, left = leg_signs(leg)
            hip, thigh, calf = q[3 * i : 3 * i + 3]
            shank = np.array([0, 0, -kin.thigh_length]) + ry(calf) @ [0, 0, -kin.calf_length]
            foot = [front * kin.hip_x, left * kin.hip_y, 0] + rx(hip) @ (
                np.array([0, left * kin.thigh_y, 0]) + ry(thigh) @ shank
            )
            np.testing.assert_allclose(physics.bind(robot.feet[i]).xpos, foot, atol=1e-9)


def test_order_is_right_front_first_everywhere(robot):
    names = [f"{leg}_{link}" for leg in LEGS for link in ("hip", "thigh", "calf")]
    assert LEGS == ("FR", "FL", "RR", "RL")
    assert [actuator.name for actuator in robot.actuators] == names
    assert [joint.name for joint in robot.joints] == [f"{name}_joint" for name in names]
    assert [actuator.joint for actuator in robot.actuators] == list(robot.joints)
    assert [foot.name for foot in robot.feet] == [f"{leg}_foot" for leg in LEGS]
    assert set(robot.body_geoms) == {"trunk", *names}
    model = mjcf.Physics.from_mjcf_model(robot.mjcf_model).model
    assert list(model.jnt_qposadr) == list(range(12))
    np.testing.assert_allclose(model.jnt_range, robot.joint_range)


def test_default_pose_turns_the_feet_inward(robot):
    np.testing.assert_allclose(robot.default_pose[[0, 3, 6, 9]], [0.15, -0.15, 0.15, -0.15])
    physics = mjcf.Physics.from_mjcf_model(robot.mjcf_model)
    width = {}
    for name, hips in (("default", robot.default_pose[::3]), ("straight", np.zeros(4))):
        pose = robot.default_pose
        pose[::3] = hips
        with physics.reset_context():
            physics.bind(robot.joints).qpos = pose
        width[name] = np.abs(np.array(physics.bind(robot.feet).xpos)[:, 1])
    assert (width["default"] < width["straight"] - 0.03).all()
    np.testing.assert_allclose(robot.action_scale, [0.2, 0.35, 0.35] * 4)


def test_actuator_force_is_the_motor_law_up_to_the_speed_limit(held):
    entity, physics = held
    q = entity.default_pose
    seen = np.zeros(4, dtype=bool)
    for offset in np.linspace(-2.5, 2.5, 21):
        for v in np.linspace(-SPEED, SPEED, 22):
            force = actuator_force(entity, physics, q + offset, q, v)
            np.testing.assert_allclose(force, motor_law(q + offset, q, v), atol=1e-9)
            command = 35 * offset - 0.7 * v
            seen |= [
                abs(force[0] - command) < 1e-6,  # inside the limits
                abs(abs(force[0]) - TORQUE) < 1e-6,  # at the stall torque
                abs(force[0]) < abs(command) - 1 and force[0] * v > 0,  # on the line, driving
                abs(force[0]) > 10 and force[0] * v < 0,  # braking
            ]
    assert seen.all(), "the grid must reach every branch of the law"
    assert physics.model.na == 0


def test_motor_brakes_above_the_speed_limit(held):
    entity, physics = held
    q = entity.default_pose
    force = actuator_force(entity, physics, q + 3.0, q, 25.0)
    np.testing.assert_allclose(force, TORQUE * (1 - 25.0 / SPEED))


def test_each_control_drives_its_own_joint(held):
    entity, physics = held
    q = entity.default_pose
    target = q + np.linspace(-0.3, 0.3, 12)
    np.testing.assert_allclose(actuator_force(entity, physics, target, q, 0.0), 35 * (target - q), atol=1e-9)


def test_scale_gains_changes_the_force(held):
    entity, physics = held
    model = physics.model.ptr
    original = model.actuator_gainprm.copy()
    rng = np.random.default_rng(1)
    q, offset, v = entity.default_pose, rng.uniform(-0.3, 0.3, 12), rng.uniform(-3, 3, 12)
    kp_scale, kd_scale = rng.uniform(0.5, 2, (3, 12)), rng.uniform(0.5, 2, (3, 12))
    batch = scale_gains(np.tile(original, (3, 1, 1)), kp_scale, kd_scale)
    assert batch.shape == (3, 12, 10)
    try:
        for world in range(3):
            model.actuator_gainprm[:] = batch[world]
            force = actuator_force(entity, physics, q + offset, q, v)
            expected = motor_law(q + offset, q, v, 35 * kp_scale[world], 0.7 * kd_scale[world])
            np.testing.assert_allclose(force, expected, atol=1e-9)
    finally:
        model.actuator_gainprm[:] = original
    assert (original[:, KP_INDEX] == 35).all()
    assert (original[:, KD_INDEX] == 0.7).all()


def test_scale_gains_takes_tensors_and_leaves_its_input_alone():
    torch = pytest.importorskip("torch")
    gains = torch.ones(2, 12, 10)
    scaled = scale_gains(gains, torch.full((2, 1), 1.5), torch.full((2, 1), 0.5))
    assert (gains == 1).all()
    assert (scaled[..., KP_INDEX] == 1.5).all()
    assert (scaled[..., KD_INDEX] == 0.5).all()
    assert scaled.sum() == pytest.approx(gains.sum().item())


def test_stands_on_its_feet_alone(standing):
    entity, _, physics = standing
    contacts = {tuple(sorted((c.geom1, c.geom2))) for c in physics.data.contact}
    floor = physics.model.name2id("floor", "geom")
    feet = set(physics.bind(entity.foot_geoms).element_id)
    assert contacts == {tuple(sorted((floor, foot))) for foot in feet}
    position, quaternion = entity.get_pose(physics)
    assert 0.28 < position[2] < 0.33
    assert abs(quaternion[0]) > 0.99


def test_root_frame_is_the_trunk(standing):
    entity, frame, physics = standing
    body = physics.bind(frame)
    np.testing.assert_allclose(physics.bind(entity.trunk).xpos, body.xpos, atol=1e-12)
    np.testing.assert_allclose(physics.bind(entity.imu).xpos, body.xpos, atol=1e-12)


def test_contact_bits_and_groups(robot):
    model = mjcf.Physics.from_mjcf_model(robot.mjcf_model).model
    solid = model.geom_contype != 0
    assert solid.sum() == 4 + 13
    assert (model.geom_contype[solid] == 1).all()
    assert (model.geom_conaffinity == 0).all()
    assert (model.geom_group[solid] == 3).all()
    assert (model.geom_group[~solid] == 2).all()
    assert (model.geom_condim[solid] == 3).all()


def test_foot_and_joint_settings_reach_the_model():
    config = defaults.robot(foot_friction=0.37, joint_friction=0.2, joint_damping=0.05, armature=0.02, torque_limit=20)
    entity = Quadruped(config)
    physics = mjcf.Physics.from_mjcf_model(entity.mjcf_model)
    np.testing.assert_allclose(physics.bind(entity.foot_geoms).friction[:, 0], 0.37)
    np.testing.assert_allclose(physics.model.dof_frictionloss, 0.2)
    np.testing.assert_allclose(physics.model.dof_damping, 0.05)
    np.testing.assert_allclose(physics.model.dof_armature, 0.02)
    q = entity.default_pose
    np.testing.assert_allclose(actuator_force(entity, physics, q - 2, q, 0.0), -20)


@pytest.mark.parametrize("calf", [-2.69, -1.5, -0.92])
@pytest.mark.parametrize("pitch", [-1.4, -0.7, 0.0, 0.7, 1.4])
def test_shank_stays_above_the_ball_of_the_foot(calf, pitch):
    """Whatever the shank's pitch short of horizontal, the foot is the calf's lowest point."""
    entity = Quadruped(defaults.robot())
    physics = mjcf.Physics.from_mjcf_model(entity.mjcf_model)
    with physics.reset_context():
        physics.bind(entity.joints).qpos = [0, pitch - calf, calf] * 4
    foot = physics.bind(entity.foot_geoms[0])
    shank = physics.bind(entity.body_geoms["FR_calf"][0])
    axis = np.array(shank.xmat).reshape(3, 3)[:, 2] * shank.size[1]
    ends = [(np.array(shank.xpos) + sign * axis)[2] - shank.size[0] for sign in (-1, 1)]
    assert min(ends) > foot.xpos[2] - foot.size[0]


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("variant", "a2"),
        ("kp", 0.0),
        ("kd", -0.1),
        ("torque_limit", -1.0),
        ("speed_limit", float("nan")),
        ("hip_inward", 0.9),
        ("thigh", 5.0),
        ("calf", -0.5),
        ("action_scale_calf", -0.1),
        ("action_clip", 0.0),
        ("foot_friction", -0.5),
    ],
)
def test_bad_settings_are_named(setting, value):
    config = defaults.robot(**{setting: value})
    with pytest.raises(ConfigError, match=rf"^robot\.{setting}=.* must be ") as error:
        config.validate()
    assert "\n" not in str(error.value)
    with pytest.raises(ConfigError):
        Quadruped(config)


@pytest.mark.parametrize("name", VARIANTS)
def test_yaml_has_every_setting(name):
    folder = Path(__file__).parents[3] / "conf" / "robot"
    with initialize_config_dir(str(folder), version_base="1.3"):
        loaded = compose(name)
    values = OmegaConf.to_container(loaded)
    assert set(values) == {field.name for field in fields(RobotConfig)}
    assert defaults.robot(**values) == defaults.robot(variant=name)


def test_compiles_under_mujoco_without_warnings(robot, capfd):
    mujoco.MjModel.from_xml_string(robot.mjcf_model.to_xml_string(), robot.mjcf_model.get_assets())
    assert capfd.readouterr().err == ""
