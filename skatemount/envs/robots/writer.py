"""A robot that was read from a file as a Python module, and its settings as YAML."""

from __future__ import annotations

import math
import textwrap

import numpy as np

from skatemount.envs.robots.reader import RobotFile
from skatemount.envs.robots.spec import Box, Capsule, Inertial, Leg, LegKinematics, RobotSpec

_FEET_WIDTH = 0.0875
"""Distance, m, of the feet from the middle line in the default pose; the deck's half width is 0.125 m."""
_THIGH, _CALF = 0.8, -1.5
"""Default angles of thigh and calf, rad, if the joints' ranges allow them."""
_GAIN = 19.0
"""Position gain per weight and length of a leg, 1/rad m/s^2: that of the Go2."""
_REACTION = 1.0
"""Torque per unit of action and mass, N m/kg: that of the A1 and the Go2."""


def module_text(robot: RobotFile, source: str) -> str:
    """Return a module that registers a robot when it is imported.

    Args:
        robot: The robot and what its file says.
        source: Name of the file, for the docstring.
    """
    spec = robot.spec
    constant = spec.name.upper() if spec.name.isidentifier() else "ROBOT"
    mass = spec.trunk_inertial.mass + sum(link.inertial.mass for link in spec.links)
    notes = "".join(textwrap.fill(f"- {note}", 118, subsequent_indent="  ") + "\n" for note in robot.notes)
    legs = ",\n".join(_indent(_leg(leg), 8) for leg in spec.legs)
    trunk = _indent(_inertial(spec.trunk_inertial), 4).lstrip()
    return f'''"""The robot {spec.name}: {mass:.3f} kg, from {source} by `skatemount robot-spec`.
{
        f"""
{notes}"""
        if notes
        else ""
    }"""

import numpy as np

from skatemount.envs.robots import ROBOTS
from skatemount.envs.robots.spec import Box, Capsule, Inertial, Leg, LegKinematics, Link, RobotSpec, symmetric

{constant} = RobotSpec(
    name={_quoted(spec.name)},
    trunk={_quoted(spec.trunk)},
    trunk_inertial={trunk},
    trunk_shape={_shape(spec.trunk_shape)},
    legs=(
{legs},
    ),
    kinematics={_kinematics(spec.kinematics)},
    leg_radius={_number(spec.leg_radius)},
)
ROBOTS[{_quoted(spec.name)}] = {constant}
'''


def settings_text(robot: RobotFile) -> str:
    """Return a first version of a robot's settings, ``robot/<name>.yaml``.

    The gains grow with weight and length of the legs. The feet stand within the width of the default board.
    """
    spec = robot.spec
    kin = spec.kinematics
    mass = spec.trunk_inertial.mass + sum(link.inertial.mass for link in spec.links)
    gain = round(_GAIN * mass * kin.thigh_length)
    thigh, calf = (_within(x, spec.stance_range(i)) for i, x in ((1, _THIGH), (2, _CALF)))
    scale = _REACTION * mass / gain
    values = {
        "variant": (spec.name, "name in ROBOTS"),
        "kp": (float(gain), "position gain of every joint, N m/rad"),
        "kd": (round(gain / 40, 2), "velocity gain of every joint, N m s/rad"),
        "torque_limit": (robot.torque, "largest torque of a motor, N m"),
        "speed_limit": (robot.speed, "speed at which a motor's torque falls to zero, rad/s"),
        "hip_inward": (_hip_inward(spec, thigh, calf), "default hip angle, rad; right +, left -"),
        "thigh": (thigh, "default thigh angle, rad"),
        "calf": (calf, "default calf angle, rad"),
        "action_scale_hip": (round(0.6 * scale, 3), "joint target offset per unit of action at the hips, rad"),
        "action_scale_thigh": (round(scale, 3), "at the thighs"),
        "action_scale_calf": (round(scale, 3), "at the calves"),
    }
    lines = [f"# The robot {spec.name}, {mass:.3f} kg.", "defaults:", "  - a1", "  - _self_", ""]
    for name, (value, meaning) in values.items():
        if value is None:
            lines.append(f"# {name}: the file does not say it; this is the A1's unless you set it")
        else:
            lines.append(f"{f'{name}: {value}':26}# {meaning}")
    return "\n".join(lines) + "\n"


def _hip_inward(spec: RobotSpec, thigh: float, calf: float) -> float:
    """Return the smallest inward turn of the hips, rad, with which the feet are close enough to the middle line."""
    kin = spec.kinematics
    height = kin.thigh_length * math.cos(thigh) + kin.calf_length * math.cos(thigh + calf)
    low, high = spec.stance_range(0)
    for angle in np.arange(max(low, 0.0), high, 0.01):
        if kin.hip_y + kin.thigh_y * math.cos(angle) - height * math.sin(angle) <= _FEET_WIDTH + 1e-3:
            return round(float(angle), 2)
    return round(high, 2)


def _within(value: float, limits: tuple[float, float]) -> float:
    """Return an angle if its joint can reach it, else the middle of the range."""
    low, high = limits
    return value if low < value < high else round((low + high) / 2, 2)


def _leg(leg: Leg) -> str:
    links = []
    for link in leg.links:
        fields = [_quoted(link.name), _quoted(link.joint), _tuple(link.axis), _tuple(link.range)]
        rows = [", ".join(fields), _inertial(link.inertial)]
        if link.shape is not None:
            rows.append(_shape(link.shape))
        if link.reduction != 1:
            rows.append(f"reduction={_number(link.reduction)}")
        links.append(_call("Link", rows))
    head = ", ".join((_quoted(leg.name), _number(leg.front), _number(leg.left), _quoted(leg.foot)))
    return _call("Leg", [head, "(\n" + ",\n".join(_indent(link, 4) for link in links) + ",\n)"])


def _inertial(inertial: Inertial) -> str:
    i = inertial.inertia
    main, other = (", ".join(map(_number, each)) for each in ((i[0, 0], i[1, 1], i[2, 2]), (i[0, 1], i[0, 2], i[1, 2])))
    com = f"np.array([{', '.join(_number(x) for x in inertial.com)}])"
    return _call("Inertial", [f"{_number(inertial.mass)}, {com}", _call("symmetric", [main, other])])


def _shape(shape: Box | Capsule) -> str:
    if isinstance(shape, Box):
        return f"Box({_tuple(shape.half_size)}, {_tuple(shape.center)})"
    return f"Capsule({_number(shape.radius)}, {_tuple(shape.start)}, {_tuple(shape.end)})"


def _kinematics(kinematics: LegKinematics) -> str:
    values = ",\n".join(f"        {name}={_number(value)}" for name, value in vars(kinematics).items())
    return f"LegKinematics(\n{values},\n    )"


def _call(name: str, rows: list[str]) -> str:
    return f"{name}(\n" + ",\n".join(_indent(row, 4) for row in rows) + ",\n)"


def _indent(text: str, by: int) -> str:
    return textwrap.indent(text, " " * by)


def _tuple(values: tuple[float, ...]) -> str:
    return f"({', '.join(_number(each) for each in values)})"


def _number(value: float) -> str:
    return repr(float(value) + 0.0)


def _quoted(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'
