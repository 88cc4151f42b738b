"""A real robot under an exported policy: limits, a ramp to the first pose, a watchdog, and an emergency stop.

Write a class with the methods of `Robot` for your hardware and call `run`.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from skatemount.runner.controller import Controller
from skatemount.runner.folder import PolicyFolder, RunnerError


class Robot(Protocol):
    """The interface to a robot, or to a simulation of one. Joints are in the order of the card."""

    def read(self) -> Mapping[str, Any]:
        """Return the newest measurements by name, in the units and frames of the card.

        ``joint_pos``, ``joint_vel`` and ``gravity`` are always needed, for the limits, and everything that
        ``card["measurements"]`` names.
        """
        ...

    def write(self, targets: np.ndarray, kp: np.ndarray, kd: np.ndarray) -> None:
        """Give the motor controllers new targets, ``kp (target - angle) - kd speed``.

        Args:
            targets: ``[J]`` rad.
            kp: ``[J]`` N m/rad.
            kd: ``[J]`` N m s/rad.
        """
        ...

    def stop(self) -> None:
        """Make the robot safe at once: no position control, only damping. It may be called from another thread."""
        ...


class EmergencyStop(RuntimeError):
    """The robot was stopped because a limit was reached; the message is one line."""


@dataclass(frozen=True)
class Limits:
    """Limits within which a policy may drive a robot.

    Attributes:
        tilt: Largest angle of the trunk from upright, degrees.
        joint_margin: Distance that targets keep from the ends of the joints' ranges, rad.
        beyond_range: Angle beyond the end of a joint's range at which the robot is stopped, rad.
        torque: Largest share of each motor's torque limit; targets that ask for more are moved toward the joint.
        speed: Largest share of each motor's speed limit; a faster joint stops the robot.
        ramp: Duration of the move to the default pose at the beginning, s.
        settle: Time that the robot then holds this pose, s.
        watchdog: Time without a new target after which another thread stops the robot, s.
        overruns: Number of control steps in a row that may end late before the robot is stopped.
    """

    tilt: float = 60.0
    joint_margin: float = 0.02
    beyond_range: float = 0.1
    torque: float = 1.0
    speed: float = 1.5
    ramp: float = 2.0
    settle: float = 0.5
    watchdog: float = 0.2
    overruns: int = 5

    def __post_init__(self) -> None:
        """Raise `RunnerError` for a limit that cannot be used."""
        for name, value in vars(self).items():
            if not (np.isfinite(value) and value >= 0):
                raise RunnerError(f"limits.{name}={value} must be 0 or more, and finite")
        for name in ("tilt", "torque", "speed", "watchdog"):
            if getattr(self, name) == 0:
                raise RunnerError(f"limits.{name}=0 must be above 0, or nothing could move")


@dataclass
class Motors:
    """The robot's motors, from the card.

    Attributes:
        kp: ``[J]`` N m/rad.
        kd: ``[J]`` N m s/rad.
        torque: ``[J]`` largest torque, N m.
        speed: ``[J]`` speed at which the torque falls to zero, rad/s.
        low: ``[J]`` lower end of the range, rad.
        high: ``[J]`` upper end of the range, rad.
        default: ``[J]`` default pose, rad.
        names: Names of the joints.
    """

    kp: np.ndarray
    kd: np.ndarray
    torque: np.ndarray
    speed: np.ndarray
    low: np.ndarray
    high: np.ndarray
    default: np.ndarray
    names: list[str] = field(default_factory=list)

    @classmethod
    def of(cls, card: Mapping[str, Any]) -> Motors:
        """Return the motors that a card describes."""
        motors = card["motors"]

        def column(key: str) -> np.ndarray:
            return np.array([motor[key] for motor in motors], float)

        ranges = column("range")
        return cls(
            kp=column("kp"),
            kd=column("kd"),
            torque=column("torque_limit"),
            speed=column("speed_limit"),
            low=ranges[:, 0],
            high=ranges[:, 1],
            default=column("default"),
            names=[motor["joint"] for motor in motors],
        )


def limited(targets: np.ndarray, measured: Mapping[str, Any], motors: Motors, limits: Limits) -> np.ndarray:
    """Return the targets that keep joints within their ranges and motors within their torques.

    The torque that a target asks for is ``kp (target - angle) - kd speed``. Where it is above the limit T, the target
    becomes ``angle + (clip(torque, -T, T) + kd speed) / kp``. The range comes last: it holds in any case.

    Args:
        targets: ``[J]`` rad.
        measured: Measurements, with ``joint_pos`` and ``joint_vel``.
        motors: The motors.
        limits: The limits.

    Returns:
        ``[J]`` rad.
    """
    angle, speed = (np.asarray(measured[name], float).ravel() for name in ("joint_pos", "joint_vel"))
    torque, most = motors.kp * (targets - angle) - motors.kd * speed, limits.torque * motors.torque
    possible = angle + (np.clip(torque, -most, most) + motors.kd * speed) / motors.kp
    # Within the limit the target stays exactly what the policy said.
    allowed = np.where(np.abs(torque) > most, possible, targets)
    return np.clip(allowed, motors.low + limits.joint_margin, motors.high - limits.joint_margin)


def check_state(measured: Mapping[str, Any], motors: Motors, limits: Limits) -> None:
    """Check that the robot is in a state in which a policy may go on.

    Args:
        measured: Measurements, with ``joint_pos``, ``joint_vel`` and ``gravity``.
        motors: The motors.
        limits: The limits.

    Raises:
        EmergencyStop: A measurement is missing or not finite, the trunk is tilted too far, or a joint is beyond its
            range or too fast.
    """
    values = {}
    for name, size in (("joint_pos", len(motors.kp)), ("joint_vel", len(motors.kp)), ("gravity", 3)):
        value = np.asarray(measured.get(name, ()), float).ravel()
        if value.size != size or not np.isfinite(value).all():
            raise EmergencyStop(f"measurement {name}={value.tolist()} must be {size} finite numbers")
        values[name] = value
    down = -values["gravity"][2] / max(float(np.linalg.norm(values["gravity"])), 1e-9)
    tilt = float(np.degrees(np.arccos(np.clip(down, -1.0, 1.0))))
    if tilt > limits.tilt:
        raise EmergencyStop(f"the trunk is tilted by {tilt:.0f} degrees; limits.tilt={limits.tilt:g} allows less")
    angle, speed = values["joint_pos"], np.abs(values["joint_vel"])
    beyond = np.maximum(motors.low - angle, angle - motors.high)
    worst = int(beyond.argmax())
    if beyond[worst] > limits.beyond_range:
        raise EmergencyStop(
            f"joint {motors.names[worst]} is at {angle[worst]:.2f} rad, {beyond[worst]:.2f} rad beyond its range; "
            f"limits.beyond_range={limits.beyond_range:g} allows less"
        )
    worst = int((speed / motors.speed).argmax())
    if speed[worst] > limits.speed * motors.speed[worst]:
        raise EmergencyStop(
            f"joint {motors.names[worst]} moves at {speed[worst]:.1f} rad/s; limits.speed={limits.speed:g} of "
            f"{motors.speed[worst]:g} rad/s allows less"
        )


class Watchdog:
    """A thread that stops a robot when it is not fed in time, such as when reading a sensor hangs.

    Args:
        stop: Called once, from the thread.
        patience: Time without `feed` after which it is called, s.

    Attributes:
        fired: True once it has stopped the robot.
    """

    def __init__(self, stop: Callable[[], None], patience: float):
        self.fired = False
        self._stop, self._patience = stop, patience
        self._fed, self._over = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._watch, name="watchdog", daemon=True)
        self._thread.start()

    def feed(self) -> None:
        """Say that all is well."""
        self._fed.set()

    def end(self) -> None:
        """Stop watching."""
        self._over.set()
        self._fed.set()
        self._thread.join(timeout=1.0)

    def _watch(self) -> None:
        while not self._over.is_set():
            if not self._fed.wait(self._patience):
                self.fired = True
                self._stop()
                return
            self._fed.clear()


@dataclass
class Report:
    """Counts of the control steps of a run on a robot.

    Attributes:
        steps: Control steps under the policy.
        late: Control steps that ended late.
        changed: Control steps in which a limit changed a target.
    """

    steps: int = 0
    late: int = 0
    changed: int = 0


def run(
    folder: PolicyFolder,
    robot: Robot,
    seconds: float | None = None,
    limits: Limits | None = None,
    proceed: Callable[[], bool] = lambda: True,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> Report:
    """Drive a robot: check the policy, move to the default pose, then act until the time is over.

    However it ends, the robot is stopped.

    Args:
        folder: The exported policy.
        robot: The robot.
        seconds: Duration under the policy; without end if None.
        limits: Limits; the defaults if None.
        proceed: Called in every control step; the run ends when it returns False.
        clock: Returns the time, s.
        sleep: Waits for a time, s.

    Returns:
        What it did.

    Raises:
        EmergencyStop: A limit was reached, or the watchdog stopped the robot.
        RunnerError: The folder computes something else than its test vectors, or a measurement is missing.
    """
    limits = limits or Limits()
    folder.check()
    controller, motors = Controller(folder), Motors.of(folder.card)
    period, report = float(folder.card["control"]["control_step"]), Report()
    watchdog = Watchdog(robot.stop, max(limits.watchdog, 2 * period))
    pace = _Pace(period, limits, clock, sleep, report)

    def step(choose: Callable[[Mapping[str, Any]], np.ndarray]) -> None:
        measured = robot.read()
        if watchdog.fired:
            raise EmergencyStop(f"no new target within limits.watchdog={limits.watchdog:g} s")
        check_state(measured, motors, limits)
        wanted = choose(measured)
        allowed = limited(wanted, measured, motors, limits)
        report.changed += bool((allowed != wanted).any())
        robot.write(allowed, motors.kp, motors.kd)
        watchdog.feed()
        pace.wait()

    try:
        first = np.asarray(robot.read()["joint_pos"], float).ravel()
        moves, holds = max(1, round(limits.ramp / period)), round(limits.settle / period)
        for i in range(moves + holds):
            if not proceed():
                return report
            share = min(1.0, (i + 1) / moves)
            pose = first + share * (motors.default - first)
            step(lambda measured, pose=pose: pose)  # type: ignore[misc]
        report.changed = report.late = 0
        controller.begin()
        count = None if seconds is None else round(seconds / period)
        while proceed() and (count is None or report.steps < count):
            step(controller.step)
            report.steps += 1
        return report
    finally:
        watchdog.end()
        robot.stop()


class _Pace:
    """The clock of the control steps."""

    def __init__(
        self,
        period: float,
        limits: Limits,
        clock: Callable[[], float],
        sleep: Callable[[float], None],
        report: Report,
    ):
        self._period, self._limits, self._clock, self._sleep, self._report = period, limits, clock, sleep, report
        self._next, self._in_a_row = clock() + period, 0

    def wait(self) -> None:
        """Wait for the next control step.

        Raises:
            EmergencyStop: Too many steps in a row ended late.
        """
        left = self._next - self._clock()
        if left > 0:
            self._sleep(left)
            self._in_a_row = 0
            self._next += self._period
            return
        self._report.late += 1
        self._in_a_row += 1
        if self._in_a_row > self._limits.overruns:
            raise EmergencyStop(
                f"{self._in_a_row} control steps in a row took longer than {self._period:g} s; "
                f"limits.overruns={self._limits.overruns} allows less"
            )
        # A late step moves the next ones, so that the robot does not hurry after lost time.
        self._next = self._clock() + self._period
