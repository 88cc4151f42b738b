"""The example of a robot's drivers: what they measure becomes what the card names."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import exported
import numpy as np
import pytest


@pytest.fixture
def driver(repo_root: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Any, Any, Any]]:
    """The robot, its drivers, and the card."""
    import sys

    monkeypatch.syspath_prepend(str(repo_root / "examples" / "own_driver"))
    from my_robot import MyRobot
    from stand_in import Bus

    folder = exported.folder()
    card = json.loads((folder / "card.json").read_text(encoding="utf-8"))
    bus = Bus(folder, card)
    yield MyRobot(bus, card), bus, card
    for module in ("my_robot", "stand_in"):
        del sys.modules[module]


def test_measurements_are_in_the_frames_and_the_order_of_the_card(driver: tuple[Any, Any, Any]) -> None:
    robot, bus, card = driver
    assert bus.motor_names != [motor["joint"] for motor in card["motors"]]
    bus.data.joint(bus.trunk).qpos[3:] = np.array([0.9, 0.1, -0.2, 0.3]) / np.linalg.norm([0.9, 0.1, -0.2, 0.3])
    bus.data.joint("board/").qpos[3:] = np.array([0.8, 0.0, 0.0, 0.6])
    bus.wait(0.04)
    bus.wait(0.04)
    measured, data = robot.read(), bus.data
    trunk = data.body(bus.trunk).xmat.reshape(3, 3)
    np.testing.assert_allclose(measured["gravity"], trunk.T @ [0, 0, -1], atol=1e-9)
    joints = card["scene"]["joints"]
    np.testing.assert_allclose(measured["joint_pos"], [data.joint(name).qpos[0] for name in joints])
    np.testing.assert_allclose(measured["joint_vel"], [data.joint(name).qvel[0] for name in joints])
    # The picture is one control step old.
    assert measured["board_age"] == pytest.approx(0.04)
    bus.pictures.popleft()
    measured = robot.read()
    board = data.body(bus.board)
    np.testing.assert_allclose(measured["board_pos_base"], trunk.T @ (board.xpos - data.body(bus.trunk).xpos))
    np.testing.assert_allclose(measured["board_rot_base"], trunk.T @ board.xmat.reshape(3, 3), atol=1e-9)


def test_targets_reach_the_motors_of_their_joints(driver: tuple[Any, Any, Any]) -> None:
    robot, bus, card = driver
    targets = np.arange(12) / 10
    robot.write(targets, 20 + targets, 1 + targets)
    motors = [bus.model.actuator(name).id for name in card["scene"]["actuators"]]
    np.testing.assert_allclose(bus.data.ctrl[motors], targets)
    np.testing.assert_allclose(bus.model.actuator_gainprm[motors, 0], 20 + targets)
    np.testing.assert_allclose(bus.model.actuator_biasprm[motors, 2], -1 - targets)
    robot.stop()
    assert not bus.model.actuator_gainprm[motors, 0].any() and not bus.model.actuator_biasprm[motors, 1].any()
