from __future__ import annotations

import dataclasses
import threading
from collections.abc import Mapping
from typing import Any

import exported
import numpy as np
import pytest

from skatemount.runner.controller import Controller
from skatemount.runner.folder import PolicyFolder, RunnerError
from skatemount.runner.hardware import EmergencyStop, Limits, Motors, Watchdog, check_state, limited, run
from skatemount.runner.simulated_robot import SimulatedRobot


@pytest.fixture(scope="module")
def folder() -> PolicyFolder:
    return PolicyFolder(exported.folder())


@pytest.fixture(scope="module")
def motors(folder: PolicyFolder) -> Motors:
    return Motors.of(folder.card)


def state(motors: Motors, **changes: Any) -> dict[str, Any]:
    return {"joint_pos": motors.default, "joint_vel": np.zeros(12), "gravity": [0, 0, -1], **changes}


def test_targets_within_the_limits_stay_as_they_are(motors: Motors) -> None:
    targets = motors.default + 0.3
    assert (limited(targets, state(motors), motors, Limits()) == targets).all()


def test_a_target_asks_for_no_more_torque_than_the_limit(motors: Motors) -> None:
    speed = np.full(12, 2.0)
    measured = state(motors, joint_vel=speed)
    wanted = motors.default + np.tile([0.3, -0.5, 0.5], 4)
    allowed = limited(wanted, measured, motors, Limits(torque=0.2))
    torque = motors.kp * (allowed - motors.default) - motors.kd * speed
    assert np.abs(torque).max() == pytest.approx(0.2 * motors.torque[0])
    assert (np.sign(torque) == np.sign(motors.kp * (wanted - motors.default) - motors.kd * speed)).all()


def test_targets_stay_within_the_joints_ranges(motors: Motors) -> None:
    allowed = limited(motors.high + 5, state(motors, joint_pos=motors.high), motors, Limits(joint_margin=0.1))
    np.testing.assert_allclose(allowed, motors.high - 0.1)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"gravity": [0.95, 0, -0.3]}, "the trunk is tilted by 72 degrees; limits.tilt=60 allows less"),
        ({"gravity": [0, 0, 1]}, "the trunk is tilted by 180 degrees"),
        ({"gravity": [0, 0]}, "measurement gravity=[0.0, 0.0] must be 3 finite numbers"),
        ({"joint_pos": np.full(12, np.nan)}, "measurement joint_pos=[nan"),
        ({"joint_vel": np.eye(12)[1] * 40}, "joint FR_thigh moves at 40.0 rad/s; limits.speed=1.5 of 21 rad/s"),
        ({"joint_pos": [2.0, 0.8, -1.5] * 4}, "joint FR_hip is at 2.00 rad, 1.20 rad beyond its range"),
    ],
)
def test_a_state_that_stops_the_robot(motors: Motors, changes: dict[str, Any], expected: str) -> None:
    with pytest.raises(EmergencyStop) as error:
        check_state(state(motors, **changes), motors, Limits())
    assert str(error.value).startswith(expected)


@pytest.mark.parametrize(
    ("limits", "expected"),
    [({"tilt": 0}, "limits.tilt=0 must be above 0"), ({"ramp": -1}, "limits.ramp=-1 must be 0 or more")],
)
def test_limits_that_cannot_be_used(limits: dict[str, float], expected: str) -> None:
    with pytest.raises(RunnerError, match=expected):
        Limits(**limits)


class Clock:
    """Time that passes only while the robot waits, and in steps that take too long."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


CALM = Limits(ramp=0.0, settle=0.0, watchdog=60.0, tilt=180.0, speed=100.0, beyond_range=10.0)


def test_a_robot_gets_the_policys_targets_and_is_stopped_at_the_end(folder: PolicyFolder) -> None:
    robot, clock = SimulatedRobot(folder, "stand"), Clock()
    report = run(folder, robot, 0.4, CALM, clock=clock, sleep=clock.sleep)
    assert (report.steps, report.late) == (10, 0)
    # One step to the default pose comes first.
    assert clock.now == pytest.approx(11 * 0.04)
    assert robot.stopped
    other, controller = SimulatedRobot(folder, "stand"), Controller(folder)
    motors = Motors.of(folder.card)
    other.write(motors.default, motors.kp, motors.kd)
    for _ in range(10):
        other.write(controller.step(other.read()), motors.kp, motors.kd)
    np.testing.assert_allclose(robot.world.data.qpos, other.world.data.qpos, atol=1e-6)


def test_it_moves_to_the_default_pose_first(folder: PolicyFolder) -> None:
    written: list[np.ndarray] = []

    class Recorded(SimulatedRobot):
        def write(self, targets: np.ndarray, kp: np.ndarray, kd: np.ndarray) -> None:
            written.append(targets)
            super().write(targets, kp, kd)

    robot, clock = Recorded(folder, "stand"), Clock()
    first = np.array(robot.read()["joint_pos"])
    limits = dataclasses.replace(CALM, ramp=0.4, settle=0.2)
    run(folder, robot, 0.0, limits, clock=clock, sleep=clock.sleep)
    assert len(written) == 15
    default = Motors.of(folder.card).default
    for i, targets in enumerate(written):
        np.testing.assert_allclose(targets, first + min(1.0, (i + 1) / 10) * (default - first), atol=1e-6)


def test_it_ends_when_asked(folder: PolicyFolder) -> None:
    robot, clock, answers = SimulatedRobot(folder, "stand"), Clock(), iter([True] * 4 + [False])
    report = run(folder, robot, None, CALM, lambda: next(answers), clock, clock.sleep)
    assert report.steps == 3 and robot.stopped


@pytest.mark.parametrize("late", [2, 4])
def test_late_steps(folder: PolicyFolder, late: int) -> None:
    clock = Clock()

    class Slow(SimulatedRobot):
        def write(self, targets: np.ndarray, kp: np.ndarray, kd: np.ndarray) -> None:
            super().write(targets, kp, kd)
            if 3 <= self.world.step_number < 3 + late:
                clock.now += 0.05

    robot = Slow(folder, "stand")
    limits = dataclasses.replace(CALM, overruns=3)
    if late <= 3:
        assert run(folder, robot, 0.4, limits, clock=clock, sleep=clock.sleep).late == late
    else:
        with pytest.raises(EmergencyStop, match="4 control steps in a row took longer than 0.04 s; limits.overruns=3"):
            run(folder, robot, 0.4, limits, clock=clock, sleep=clock.sleep)
    assert robot.stopped


def test_a_tilt_stops_the_robot(folder: PolicyFolder) -> None:
    class Fallen(SimulatedRobot):
        def read(self) -> Mapping[str, Any]:
            gravity = [1, 0, 0] if self.world.step_number > 2 else [0, 0, -1]
            return {**super().read(), "gravity": gravity}

    robot, clock = Fallen(folder, "stand"), Clock()
    with pytest.raises(EmergencyStop, match="tilted by 90 degrees"):
        run(folder, robot, 1.0, dataclasses.replace(CALM, tilt=45), clock=clock, sleep=clock.sleep)
    assert robot.stopped and robot.world.step_number == 3


def test_the_watchdog_stops_a_robot_that_hangs() -> None:
    stopped = threading.Event()
    watchdog = Watchdog(stopped.set, 0.01)
    assert stopped.wait(30)
    assert watchdog.fired
    watchdog.end()


def test_a_watchdog_that_is_ended_stops_nothing() -> None:
    stopped = threading.Event()
    watchdog = Watchdog(stopped.set, 1000.0)
    watchdog.feed()
    watchdog.end()
    assert not watchdog.fired and not stopped.is_set()


def test_a_sensor_that_hangs_ends_the_run(folder: PolicyFolder) -> None:
    robot_stopped, clock = threading.Event(), Clock()

    class Hanging(SimulatedRobot):
        def read(self) -> Mapping[str, Any]:
            if self.world.step_number == 3:
                # Until the watchdog's thread stops the robot.
                assert robot_stopped.wait(30)
            return super().read()

        def stop(self) -> None:
            robot_stopped.set()

    limits = dataclasses.replace(CALM, watchdog=0.05)
    robot = Hanging(folder, "stand")
    with pytest.raises(EmergencyStop, match=r"no new target within limits.watchdog=0.05 s"):
        run(folder, robot, 1.0, limits, clock=clock, sleep=clock.sleep)
    assert robot.world.step_number == 3


def test_a_stopped_robot_does_not_move(folder: PolicyFolder) -> None:
    robot = SimulatedRobot(folder, "stand", 1)
    robot.stop()
    with pytest.raises(RunnerError, match="the robot is stopped"):
        robot.write(np.zeros(12), np.zeros(12), np.zeros(12))
    with pytest.raises(RunnerError, match="suite=far: the folder has stand"):
        SimulatedRobot(folder, "far")
