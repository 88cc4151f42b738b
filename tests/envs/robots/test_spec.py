"""A spec says what makes no quadruped, and the entity has the numbers that it gives."""

from __future__ import annotations

import dataclasses

import defaults
import numpy as np
import pytest
import torch
from dm_control import mjcf
from made_up_robot import ANKLE, ANKLE_SCALE, SPEC

from skatemount.envs.entities.quadruped import Quadruped
from skatemount.envs.legs import Legs
from skatemount.envs.robots import A1, ROBOTS, RobotSpec
from skatemount.envs.robots.spec import Inertial, merge, symmetric
from skatemount.utils.errors import ConfigError


@pytest.fixture
def beetle(monkeypatch: pytest.MonkeyPatch) -> Quadruped:
    monkeypatch.setitem(ROBOTS, "beetle", SPEC)
    return Quadruped(config=defaults.robot(variant="beetle", armature=0.02, torque_limit=30.0, speed_limit=21.0))


def change_leg(spec: RobotSpec, index: int, **changes: object) -> tuple:
    return tuple(dataclasses.replace(leg, **changes) if i == index else leg for i, leg in enumerate(spec.legs))


def change_link(spec: RobotSpec, index: int, **changes: object) -> tuple:
    links = spec.legs[0].links
    changed = (dataclasses.replace(link, **changes) if i == index else link for i, link in enumerate(links))
    return change_leg(spec, 0, links=tuple(changed))


def change_inertial(**changes: object) -> tuple:
    return change_link(A1, 0, inertial=dataclasses.replace(A1.legs[0].links[0].inertial, **changes))


@pytest.mark.parametrize(
    ("legs", "message"),
    [
        (A1.legs[:3], "legs must be one each of front and rear"),
        (change_leg(A1, 0, left=1.0), "legs must be one each of front and rear"),
        (change_leg(A1, 1, foot=""), "leg FL must name its foot"),
        (change_leg(A1, 2, links=A1.legs[2].links[:2]), r"equal numbers of links.*\[3, 3, 2, 3\]"),
        (change_link(A1, 1, axis=(0.0, 0.0, 1.0)), "axis of FR_thigh must be"),
        (change_link(A1, 1, range=(1.0, 1.0)), "range of FR_thigh must rise"),
        (change_link(A1, 1, range=(1.0, -1.0)), r"range of FR_thigh must rise, not be \(1.0, -1.0\)"),
        (change_link(A1, 2, reduction=0.0), "reduction of FR_calf must be above 0, not 0.0"),
        (change_inertial(mass=0.0), "the mass of FR_hip must be above 0 kg, not 0.0"),
        (change_inertial(com=np.zeros(2)), "the center of mass of FR_hip must be 3 finite numbers"),
        (change_inertial(inertia=np.triu(np.ones((3, 3)))), "the inertia of FR_hip must be a symmetric 3 x 3 matrix"),
        (change_inertial(inertia=np.diag([-1e-4, 1e-3, 1e-3])), "inertias of FR_hip must be above 0 .* is -0.0001$"),
        (change_inertial(inertia=np.diag([1.0, 2.0, 4.0])), "inertia of FR_hip must not exceed .* 4 > 1 \\+ 2"),
        (change_link(A1, 1, name="FR_hip"), "two body names are FR_hip"),
        (change_link(A1, 1, name="trunk"), "two body names are trunk"),
        (change_link(A1, 1, joint="FR_hip_joint"), "two joint names are FR_hip_joint"),
        (change_leg(A1, 0, foot="FL_foot"), "two foot names are FL_foot"),
    ],
)
def test_mistakes_are_named(legs: tuple, message: str) -> None:
    with pytest.raises(ValueError, match=f"^robot a1: .*{message}"):
        dataclasses.replace(A1, legs=legs)


def test_mistakes_of_the_trunk_and_the_lengths_are_named() -> None:
    with pytest.raises(ValueError, match="^robot a1: the mass of trunk must be above 0 kg, not -1.0$"):
        dataclasses.replace(A1, trunk_inertial=dataclasses.replace(A1.trunk_inertial, mass=-1.0))
    with pytest.raises(ValueError, match="^robot a1: calf_length must be above 0 m, not -0.2$"):
        dataclasses.replace(A1, kinematics=dataclasses.replace(A1.kinematics, calf_length=-0.2))
    with pytest.raises(ValueError, match="^robot a1: leg_radius must be above 0 m, not 0.0$"):
        dataclasses.replace(A1, leg_radius=0.0)


def test_an_unknown_look_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(ROBOTS, "shiny", dataclasses.replace(A1, look="chrome"))
    with pytest.raises(ConfigError, match="^robot a1: look='chrome' must be one of a1, go2, plain$"):
        Quadruped(config=defaults.robot(variant="shiny"))


def test_limits_of_the_stance_are_those_of_all_legs() -> None:
    assert A1.stance_range(0) == (-0.802851, 0.802851)
    # Outward turns of one right leg and inward turns of one left leg end earlier than those of the others.
    right = change_link(A1, 0, range=(-0.3, 0.8))
    assert dataclasses.replace(A1, legs=right).stance_range(0) == (-0.3, 0.8)
    flipped = [dataclasses.replace(leg, left=-leg.left) for leg in right]
    assert dataclasses.replace(A1, legs=tuple(flipped)).stance_range(0) == (-0.8, 0.3)
    knee = dataclasses.replace(A1, legs=change_link(A1, 2, range=(-2.0, -1.0)))
    assert knee.stance_range(2) == (-2.0, -1.0)


def test_merged_links_have_the_inertia_of_both() -> None:
    ball = Inertial(1.0, np.array([0.0, 0.0, 1.0]), symmetric(0.1, 0.1, 0.1))
    other = dataclasses.replace(ball, com=np.array([0.0, 0.0, -1.0]))
    both = merge(ball, other)
    assert both.mass == 2
    np.testing.assert_allclose(both.com, 0)
    np.testing.assert_allclose(both.inertia, np.diag([2.2, 2.2, 0.2]))


def test_a_robot_of_16_joints_has_its_own_names_and_numbers(beetle: Quadruped) -> None:
    parts = ("abductor", "femur", "tibia", "ankle")
    names = [f"{part}_{leg}" for leg in ("lf", "rf", "lh", "rh") for part in parts]
    model = mjcf.Physics.from_mjcf_model(beetle.mjcf_model).model
    assert beetle.mjcf_model.model == "beetle"
    assert [actuator.name for actuator in beetle.actuators] == names
    assert [joint.name for joint in beetle.joints] == [f"turn_{name}" for name in names]
    assert [foot.name for foot in beetle.feet] == ["sole_lf", "sole_rf", "sole_lh", "sole_rh"]
    assert list(beetle.body_geoms) == ["shell", *(name for name in names if "ankle" not in name)]
    np.testing.assert_allclose(beetle.default_pose[3::4], ANKLE)
    np.testing.assert_allclose(beetle.action_scale[3::4], ANKLE_SCALE)
    # The settings give the first three of each leg: the hips turn inward on both sides.
    np.testing.assert_allclose(beetle.default_pose[:7], [-0.15, 0.8, -1.5, ANKLE, 0.15, 0.8, -1.5])
    assert model.body_mass.sum() == pytest.approx(5 + 4 * 1.9)
    # The transmission at the knee gives more torque at less speed.
    knee = np.arange(16) % 4 == 2
    np.testing.assert_allclose(model.actuator_forcerange[:, 1], np.where(knee, 45.0, 30.0))
    np.testing.assert_allclose(model.actuator_gainprm[:, 7], np.where(knee, 14.0, 21.0))
    np.testing.assert_allclose(model.dof_armature, np.where(knee, 0.045, 0.02))


def test_kinematics_agree_with_the_compiled_robot_whatever_its_ankles_do(beetle: Quadruped) -> None:
    physics, legs = mjcf.Physics.from_mjcf_model(beetle.mjcf_model), Legs(SPEC)
    low, high = beetle.joint_range.T
    for pose in np.random.default_rng(0).uniform(low, high, (20, 16)):
        with physics.reset_context():
            physics.bind(beetle.joints).qpos = pose
        feet = legs.feet(torch.tensor(pose, dtype=torch.float32))
        np.testing.assert_allclose(feet, physics.bind(beetle.feet).xpos, atol=1e-6)
    stance = torch.tensor(beetle.default_pose, dtype=torch.float32)
    torch.testing.assert_close(legs.joints(legs.feet(stance)), stance, atol=1e-4, rtol=0)
