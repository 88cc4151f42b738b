"""A quadruped's URDF or MJCF becomes its spec; what does not fit is one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from made_up_robot import SPEC

from skatemount.config import compose_task
from skatemount.envs.entities.quadruped import Quadruped
from skatemount.envs.robots import ROBOTS, RobotSpec
from skatemount.envs.robots.reader import read_robot
from skatemount.envs.robots.spec import Box, Capsule
from skatemount.robot_spec import main
from skatemount.utils.errors import ConfigError

LEGS = {"FL": (1, 1), "FR": (1, -1), "RL": (-1, 1), "RR": (-1, -1)}


def urdf_link(name: str, mass: float, extra: str = "") -> str:
    return (
        f'<link name="{name}"><inertial><origin xyz="0.01 0 0"/><mass value="{mass}"/>'
        f'<inertia ixx="0.002" iyy="0.003" izz="0.004" ixy="0" ixz="0.0001" iyz="0"/></inertial>{extra}</link>'
    )


def urdf_joint(
    name: str, parent: str, child: str, xyz: str, kind: str = "fixed", axis: str = "", more: str = ""
) -> str:
    turn = f'<axis xyz="{axis}"/>' if axis else ""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}"/>{turn}{more}</joint>'
    )


def urdf() -> str:
    """A robot whose trunk is a mesh that is missing, with a sensor and feet that are fixed links."""
    mesh = '<collision><geometry><mesh filename="package://none/trunk.stl"/></geometry></collision>'
    ball = '<collision><geometry><sphere radius="0.02"/></geometry></collision>'
    shank = (
        '<collision><origin xyz="0 0 -0.09"/><geometry><cylinder radius="0.01" length="0.1"/></geometry></collision>'
    )
    parts = [urdf_link("base", 5, mesh), urdf_link("imu", 1), urdf_joint("imu_joint", "base", "imu", "0.1 0 0")]
    for leg, (front, left) in LEGS.items():
        limit = '<limit lower="-1" upper="1" effort="20" velocity="30"/>'
        knee = '<limit lower="-2.5" upper="-0.5" effort="30" velocity="20"/>'
        parts += [
            urdf_link(f"{leg}_hip", 0.6),
            urdf_link(f"{leg}_thigh", 0.9),
            urdf_link(f"{leg}_calf", 0.2, shank),
            urdf_link(f"{leg}_foot", 0.1, ball),
            urdf_joint(f"{leg}_a", "base", f"{leg}_hip", f"{0.2 * front} {0.05 * left} 0", "revolute", "1 0 0", limit),
            urdf_joint(f"{leg}_b", f"{leg}_hip", f"{leg}_thigh", f"0 {0.08 * left} 0", "revolute", "0 1 0", limit),
            urdf_joint(f"{leg}_c", f"{leg}_thigh", f"{leg}_calf", "0 0 -0.2", "revolute", "0 1 0", knee),
            urdf_joint(f"{leg}_d", f"{leg}_calf", f"{leg}_foot", "0 0 -0.21"),
        ]
        # Other tags name the joints, too.
        parts.append(f'<transmission name="{leg}_t"><joint name="{leg}_a"/></transmission>')
    return f'<robot name="tiny_description">{"".join(parts)}</robot>'


def mjcf() -> str:
    """A robot whose hips are 3 cm above and 1 cm behind the middle of its trunk's frame."""
    legs = "".join(
        f"""<body name="{leg}_hip" pos="{0.2 * front - 0.01} {0.05 * left} 0.03"><joint name="{leg}_x" axis="1 0 0"/>
        <inertial mass="0.6" pos="0 0 0" diaginertia="0.001 0.001 0.001"/>
        <body name="{leg}_thigh" pos="0 {0.08 * left} 0"><joint name="{leg}_y"/><geom type="capsule" size="0.015"
          fromto="0 0 -0.02 0 0 -0.18" mass="0.9"/>
        <body name="{leg}_calf" pos="0 0 -0.2"><joint name="{leg}_z" range="-2.5 -0.5"/>
          <inertial mass="0.2" pos="0 0 -0.1" diaginertia="0.001 0.001 0.0001"/>
          <geom type="box" size="0.01 0.01 0.04" pos="0.005 0 -0.06"/><geom type="capsule" size="0.01"
          fromto="0.01 0 -0.1 0 0 -0.2"/><geom name="{leg}" type="sphere" size="0.022" pos="-0.002 0 -0.21"/>
        </body></body></body>"""
        for leg, (front, left) in LEGS.items()
    )
    motors = "".join(
        f'<motor joint="{leg}_{part}" ctrlrange="-{torque} {torque}"/>'
        for leg in ("FR", "FL", "RR", "RL")
        for part, torque in (("x", 20), ("y", 20), ("z", 30))
    )
    return f"""<mujoco model="tiny"><compiler angle="radian" autolimits="true"/>
        <default><joint axis="0 1 0" range="-1 1"/></default>
        <worldbody><body name="torso"><freejoint/><geom type="box" size="0.2 0.05 0.05" mass="5"/>{legs}</body>
        </worldbody><actuator>{motors}</actuator></mujoco>"""


def written(tmp_path: Path, text: str, name: str = "robot.xml") -> Path:
    (tmp_path / name).write_text(text, encoding="utf-8")
    return tmp_path / name


def assert_same(found: RobotSpec, expected: RobotSpec) -> None:
    assert (found.name, found.trunk) == (expected.name, expected.trunk)
    assert [vars(leg) | {"links": 0} for leg in found.legs] == [vars(leg) | {"links": 0} for leg in expected.legs]
    for name, value in vars(expected.kinematics).items():
        assert getattr(found.kinematics, name) == pytest.approx(value, abs=1e-9)
    pairs = [(found.trunk_inertial, expected.trunk_inertial)]
    for link, other in zip(found.links, expected.links, strict=True):
        assert (link.name, link.joint, link.axis) == (other.name, other.joint, other.axis)
        assert link.range == pytest.approx(other.range) and link.reduction == pytest.approx(other.reduction)
        assert type(link.shape) is type(other.shape)
        pairs.append((link.inertial, other.inertial))
    for one, two in pairs:
        assert one.mass == pytest.approx(two.mass)
        np.testing.assert_allclose(one.com, two.com, atol=1e-9)
        np.testing.assert_allclose(one.inertia, two.inertia, atol=1e-11)


@pytest.mark.parametrize("name", ["a1", "go2"])
def test_a_robots_own_mjcf_gives_its_numbers(tmp_path: Path, name: str) -> None:
    robot = Quadruped(compose_task("balance", [f"robot={name}"]).robot)
    file = written(tmp_path, robot.mjcf_model.to_xml_string(precision=17))
    found = read_robot(file)
    assert_same(found.spec, robot.spec)
    assert found.spec.leg_radius <= robot.spec.leg_radius + 1e-9
    assert found.torque == robot.config.torque_limit and not found.notes


def test_further_joints_and_other_names_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(ROBOTS, "beetle", SPEC)
    robot = Quadruped(compose_task("balance", ["robot.variant=beetle"]).robot)
    found = read_robot(written(tmp_path, robot.mjcf_model.to_xml_string(precision=17)))
    assert [link.joint for link in found.spec.links] == [link.joint for link in SPEC.links]
    # Its joints' names start alike in all legs.
    assert [leg.foot for leg in found.spec.legs] == [leg.foot for leg in SPEC.legs]


def test_a_urdf_is_read_without_its_meshes(tmp_path: Path) -> None:
    found = read_robot(written(tmp_path, urdf(), "tiny.urdf"))
    spec = found.spec
    assert (spec.name, spec.trunk, found.torque, found.speed) == ("tiny", "base", 20, 30)
    assert vars(spec.kinematics) == pytest.approx(
        dict(hip_x=0.2, hip_y=0.05, thigh_y=0.08, thigh_length=0.2, calf_length=0.21, foot_radius=0.02)
    )
    assert [(leg.name, leg.front, leg.left, leg.foot) for leg in spec.legs] == [
        (leg, *signs, f"{leg}_foot") for leg, signs in LEGS.items()
    ]
    # The sensor is part of the trunk, and the foot of the calf.
    assert spec.trunk_inertial.mass == pytest.approx(6)
    np.testing.assert_allclose(spec.trunk_inertial.com, [(5 * 0.01 + 0.11) / 6, 0, 0], atol=1e-9)
    assert spec.trunk_inertial.inertia[2, 2] == pytest.approx(0.008 + 5 / 6 * 0.1**2)
    calf = spec.legs[0].links[2]
    assert calf.inertial.mass == pytest.approx(0.3) and calf.reduction == pytest.approx(1.5)
    assert calf.inertial.com == pytest.approx([0.01, 0, -0.07]) and calf.range == (-2.5, -0.5)
    assert calf.shape == Capsule(0.01, (0, 0, -0.13), (0, 0, -0.05)) or calf.shape == Capsule(
        0.01, (0, 0, -0.05), (0, 0, -0.13)
    )
    assert isinstance(spec.trunk_shape, Box)
    assert [note.split(";")[0] for note in found.notes] == [
        "Its meshes could not be loaded and are left out.",
        "The trunk has no collision shape",
    ]


def test_an_mjcf_is_read_in_the_order_of_its_motors(tmp_path: Path) -> None:
    found = read_robot(written(tmp_path, mjcf()), name="mine")
    spec = found.spec
    assert spec.name == "mine" and [leg.name for leg in spec.legs] == ["FR", "FL", "RR", "RL"]
    assert spec.kinematics.hip_x == 0.2 and found.torque == 20 and found.speed is None
    # The trunk's frame lies between the hips, below and before which is the middle of the box.
    np.testing.assert_allclose(spec.trunk_inertial.com, [0.01, 0, -0.03], atol=1e-9)
    assert spec.trunk_shape == Box((0.2, 0.05, 0.05), (0.01, 0.0, -0.03))
    thigh, calf = spec.legs[0].links[1:]
    assert thigh.inertial.mass == pytest.approx(0.9) and thigh.inertial.com[2] == pytest.approx(-0.1)
    assert isinstance(thigh.shape, Capsule) and thigh.shape.radius == 0.015
    # One capsule around box and capsule, which stays above the foot's lowest point.
    assert isinstance(calf.shape, Capsule)
    assert min(calf.shape.start[2], calf.shape.end[2]) - calf.shape.radius >= -0.21 + 0.022 - 1e-9
    assert any("moved by (-0.01, 0, 0.03) m" in note for note in found.notes)
    assert any("2.0 mm off the calves' axes" in note for note in found.notes)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            'name="FL_y"/>',
            'name="FL_y" axis="0 -1 0"/>',
            r"axis of joint FL_y must be \(0, 1, 0\) .*, not \(0, -1, 0\)",
        ),
        ('name="RR_x" axis="1 0 0"/>', 'name="RR_x" type="slide"/>', "joint RR_x must turn about one axis"),
        (
            '"RL_thigh" pos="0 0.08 0"',
            '"RL_thigh" pos="0.02 0.08 0"',
            r"joint RL_y must be at .*\(LegKinematics\), not",
        ),
        (
            'name="FR" type="sphere" size="0.022',
            'name="FR" type="capsule" size="0.022 0.01',
            "body FR_calf must end in a foot",
        ),
        ('"FL" type="sphere" size="0.022" pos="-0.002', '"FL" type="sphere" size="0.022" pos="0.02', "foot of FL_calf"),
        (
            'name="FR_y"/>',
            'name="FR_y"/><joint name="more" pos="0 0 0.1"/>',
            "body FR_thigh must have one joint, not 2",
        ),
        ("<freejoint/>", '<freejoint/><body name="tail"><joint name="t"/><geom size="0.1"/></body>', "4 legs, not 5"),
        ('mass="0.6"', 'mass="0"', "mass"),
        ("<mujoco", "<mujoc", "must be a URDF or an MJCF"),
    ],
)
def test_what_does_not_fit_is_one_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in mjcf()
    with pytest.raises(ConfigError, match=message) as error:
        read_robot(written(tmp_path, mjcf().replace(old, new, 1)))
    assert "\n" not in str(error.value) and str(error.value).startswith(str(tmp_path / "robot.xml"))


def test_a_leg_of_two_joints_is_named(tmp_path: Path) -> None:
    text = mjcf()
    for part in ('<joint name="RR_z" range="-2.5 -0.5"/>', '<motor joint="RR_z" ctrlrange="-30 30"/>'):
        assert part in text
        text = text.replace(part, "")
    with pytest.raises(ConfigError, match="the leg of RR_hip must have 3 or more joints, not 2$"):
        read_robot(written(tmp_path, text))


def test_feet_that_are_meshes_need_their_radius(tmp_path: Path) -> None:
    file = written(
        tmp_path, urdf().replace('<sphere radius="0.02"/>', '<mesh filename="package://none/f.stl"/>'), "a.urdf"
    )
    with pytest.raises(ConfigError, match="FL_calf must end in a foot: a sphere that collides, or, with --foot-radius"):
        read_robot(file)
    assert read_robot(file, foot_radius=0.03).spec.kinematics.foot_radius == 0.03


def test_a_missing_file_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main([str(tmp_path / "none.urdf")])
    assert end.value.code == 2
    assert capsys.readouterr().err == f"skatemount.robot-spec: {tmp_path / 'none.urdf'}: there is no such file\n"
