"""`skatemount robot-spec` prints a module that registers the robot, and settings with which it stands."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
import torch
import yaml

from skatemount.config import compose_task, set_user_config_dir
from skatemount.envs import MountEnv, MountTask
from skatemount.envs.entities.quadruped import Quadruped
from skatemount.envs.robots import ROBOTS
from skatemount.envs.robots.reader import read_robot
from skatemount.robot_spec import main

STILL = [f"start.{name}=[0,0]" for name in ("height", "roll", "pitch", "lin_vel", "ang_vel", "joint_pos", "joint_vel")]
"""Start states with level trunk, in the default pose, at rest."""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    robot = Quadruped(compose_task("balance", ["robot=go2"]).robot)
    (tmp_path / "some.xml").write_text(robot.mjcf_model.to_xml_string(precision=17), encoding="utf-8")
    return tmp_path / "some.xml"


def test_the_printed_module_and_settings_make_the_robot(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(ROBOTS, "some", None)  # taken out again at the end
    main([str(file), "--name", "some"])
    text = capsys.readouterr().out
    assert max(map(len, text.splitlines())) <= 120
    exec(compile(text, "some.py", "exec"), {"__name__": "some"})
    spec, expected = ROBOTS["some"], read_robot(file, "some").spec
    assert spec.kinematics == expected.kinematics and spec.name == "some"
    assert [(link.name, link.range, link.shape, link.reduction) for link in spec.links] == [
        (link.name, link.range, link.shape, link.reduction) for link in expected.links
    ]
    assert all((one.inertial.inertia == two.inertial.inertia).all() for one, two in zip(spec.links, expected.links))

    main([str(file), "--name", "some", "--settings"])
    (tmp_path / "conf" / "robot").mkdir(parents=True)
    settings = capsys.readouterr().out
    (tmp_path / "conf" / "robot" / "some.yaml").write_text(settings, encoding="utf-8")
    # The speed is the one thing that an MJCF does not say.
    values = yaml.safe_load(settings)
    assert values["torque_limit"] == 23.7 and "speed_limit" not in values and values["variant"] == "some"
    set_user_config_dir(tmp_path / "conf")
    try:
        env = MountEnv(MountTask("balance", ["robot=some", "randomization=none", *STILL]), num_worlds=8, threads=1)
        data = env.reset()
        for _ in range(25):
            data = env.step(data.set("action", torch.zeros(8, 12)))["next"]
            assert not data["terminated"].any()
        env.close(raise_if_closed=False)
    finally:
        set_user_config_dir(None)


def test_it_is_a_program_of_skatemount(
    file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from skatemount.__main__ import main as program

    monkeypatch.setattr(sys, "argv", ["skatemount", "robot-spec", str(file), "--settings"])
    program()
    assert capsys.readouterr().out.startswith("# The robot go2, 15.019 kg.\n")


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("some.py", "import this\n", "must be a URDF or an MJCF, which are XML (syntax error: line 1, column 0)"),
        ("some.urdf", "<html/>", "must be a URDF or an MJCF, an XML file of <robot> or <mujoco>, not of <html>"),
        ("some.stl", "\x80\x81", "must be a URDF or an MJCF, which are XML ("),
    ],
)
def test_a_file_of_another_kind_is_one_line(
    name: str, text: str, expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / name).write_text(text, encoding="latin-1")
    with pytest.raises(SystemExit) as ended:
        main([str(tmp_path / name)])
    err = capsys.readouterr().err
    assert ended.value.code == 2 and err.startswith(f"skatemount.robot-spec: {tmp_path / name}: {expected}")
    assert err.count("\n") == 1
