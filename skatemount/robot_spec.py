"""`skatemount robot-spec FILE`: print the spec of a quadruped from its URDF or MJCF."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from skatemount.envs.robots.reader import read_robot
from skatemount.envs.robots.writer import module_text, settings_text
from skatemount.utils.errors import ConfigError


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the module or the settings; a robot that does not fit ends the program with one line and status 2."""
    parser = argparse.ArgumentParser(
        prog="skatemount robot-spec",
        description="Read the URDF or MJCF of a quadruped, and print it as a Python module that registers the robot.",
        epilog="See docs/robots.md for the way from a file to a robot that stands.",
    )
    parser.add_argument("file", type=Path, help="the URDF or MJCF; meshes may be missing")
    parser.add_argument("--name", help="name of the robot (default: that of the model)")
    parser.add_argument(
        "--foot-radius", type=float, metavar="M", help="radius of feet that the file gives as meshes, m"
    )
    parser.add_argument("--settings", action="store_true", help="print robot/<name>.yaml instead of the module")
    options = parser.parse_args(sys.argv[1:] if arguments is None else arguments)
    try:
        robot = read_robot(options.file, options.name, options.foot_radius)
    except (ConfigError, OSError) as error:
        print(f"skatemount.robot-spec: {error}", file=sys.stderr)
        sys.exit(2)
    if options.settings:
        print(settings_text(robot), end="")
        return
    print(module_text(robot, options.file.name), end="")
    for note in robot.notes:
        print(f"note: {note}", file=sys.stderr)


if __name__ == "__main__":
    main()
