"""Drive the robot: `python drive.py FOLDER` with a folder that `skatemount export` wrote."""

from __future__ import annotations

import sys
from pathlib import Path

from my_robot import MyRobot
from stand_in import Bus

from skatemount.runner.folder import PolicyFolder
from skatemount.runner.hardware import EmergencyStop, Limits, run


def main() -> None:
    """Let the policy act for six seconds."""
    folder = PolicyFolder(Path(sys.argv[1]))
    bus = Bus(folder.path, folder.card)
    robot = MyRobot(bus, folder.card)
    try:
        # The simulation's time. On a robot leave out clock and sleep: the defaults are those of the computer.
        done = run(folder, robot, seconds=6, limits=Limits(tilt=50, torque=0.9), clock=bus.time, sleep=bus.wait)
        print(f"{done.steps} control steps, {done.late} late, limits changed targets in {done.changed} steps")
    except EmergencyStop as stopped:
        print(f"stopped: {stopped}")
    board, trunk = bus.data.body(bus.board), bus.data.body(bus.trunk)
    x, y, z = board.xmat.reshape(3, 3).T @ (trunk.xpos - board.xpos)
    print(f"the trunk ends {x:.2f} m in front of the deck's center, {y:.2f} m left of it, {z:.2f} m above it")


if __name__ == "__main__":
    main()
