"""The card of an exported policy: all that is needed to use it, in plain values."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from typing import Any

from skatemount.agents.interface import action_interface, observation_layout
from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.envs.observations.table import OBSERVATIONS
from skatemount.envs.task import MountTask
from skatemount.exporting import observe
from skatemount.exporting.mjcf import OLDEST
from skatemount.exporting.onnx_graph import MEMORY, input_shapes
from skatemount.runs.provenance import package_versions

FORMAT = 1
"""Version of the card's layout."""

_SHAPE = re.compile(r"``\[[^`]*\]``")
_FRAME = re.compile(r"\b(trunk frame|board frame|world)\b")
_UNITS = ("m", "m/s", "rad", "rad/s", "s", "in units of 100 N", "m/s and rad/s")

MEASUREMENTS = {
    "base_ang_vel": ("angular velocity of the trunk", "rad/s", "trunk frame"),
    "base_lin_vel": ("linear velocity of the trunk", "m/s", "trunk frame"),
    "gravity": ("direction of gravity, unit length; upright is (0, 0, -1)", "", "trunk frame"),
    "joint_pos": ("joint angles", "rad", None),
    "joint_vel": ("joint velocities", "rad/s", None),
    "joint_torque": ("torques of the joints", "N m", None),
    "board_pos_base": ("center of the deck's top", "m", "trunk frame"),
    "board_rot_base": ("rotation of the board; the columns are its axes, x forward and z up", "", "trunk frame"),
    "board_age": ("time since the board's pose was measured", "s", None),
    "foot_deck_force": ("contact force between each foot and the deck", "N", "world"),
    "foot_other_force": ("contact force between each foot and anything other than the deck", "N", "world"),
    observe.ON_DECK: ("1 for each foot that presses on the deck from above, else 0", "", None),
    observe.COMMAND: ("velocity command: forward, left, and turn left", "m/s, m/s, rad/s", "trunk frame"),
}
"""Meaning, unit and frame of what an observation may need; the other fields are in `skatemount.envs.state.SimState`."""


def make_card(agent: TrainedPolicy, task: MountTask, observing: Any, scene: Mapping[str, Any]) -> dict[str, Any]:
    """Return the card of a policy.

    Args:
        agent: The policy.
        task: The task that it was trained in.
        observing: Graph of the observation, ``onnx.ModelProto``.
        scene: Names of the scene's parts, `skatemount.exporting.mjcf.scene_names`.
    """
    config, robot, board = agent.config, task.scene.robot, task.scene.board.config
    solver = task.scene.solver
    return {
        "format": FORMAT,
        "policy": {
            "name": agent.name,
            "stage": agent.card.stage,
            "frames": agent.card.frames,
            "weights_sha256": agent.card.sha256,
        },
        "robot": {"name": robot.spec.name, "legs": list(robot.layout.legs), "feet": list(robot.layout.feet)},
        "control": {
            "rate_hz": round(1 / solver.control_step, 6),
            "control_step": round(solver.control_step, 6),
            "timestep": solver.timestep,
            "substeps": solver.substeps,
        },
        "observation": {
            "size": agent.networks.sizes[0],
            "order": "the terms in order; of a term with several frames the oldest frame first, the newest last",
            "formula": "clip(value, -clip, clip) * scale; a frame keeps its value in later steps",
            "first": "the first frame of an episode fills the whole history, and last_action is 0",
            "terms": observation_terms(task),
        },
        "action": {
            **action_interface(task),
            "formula": "target = default_pose + scale * clip(action, -clip, clip), rad",
        },
        "motors": motors(task),
        "measurements": measurements(observing),
        "memory": memory(observing),
        "trained_with": {
            "sensing": dataclasses.asdict(config.sensing),
            "term_noise": config.observation.noise and config.sensing.term_noise,
            "randomization": dataclasses.asdict(config.randomization),
            "command": dataclasses.asdict(config.command),
        },
        "board": {**dataclasses.asdict(board)},
        "scene": dict(scene),
        "oldest_mujoco": OLDEST,
        "settings": agent.card.config,
        "versions": package_versions(),
    }


def observation_terms(task: MountTask) -> list[dict[str, Any]]:
    """Describe each term of the observation: its place, meaning, unit, frame, clip, scale and history.

    Args:
        task: The task.
    """
    start, terms = 0, []
    settings = task.config.observation.policy
    for part in observation_layout(task):
        if part["key"] != "observation":
            continue
        meaning, unit, frame = _described(OBSERVATIONS.description(part["name"]))
        size, frames = part["size"], part.get("history_length", 1)
        terms.append(
            {
                "name": part["name"],
                "start": start,
                "stop": start + size,
                "frames": frames,
                "values": size // frames,
                "meaning": meaning,
                "unit": unit,
                "frame": frame,
                "clip": part.get("clip"),
                "scale": part["scale"],
                "noise": float(settings[part["name"]].noise),
                "params": part.get("params", {}),
            }
        )
        start += size
    return terms


def motors(task: MountTask) -> list[dict[str, Any]]:
    """Describe each joint's motor: gains, limits of torque and speed, range, and default angle.

    Args:
        task: The task.
    """
    robot = task.scene.robot
    config, ranges, pose = robot.config, robot.joint_range, robot.default_pose
    return [
        {
            "joint": name,
            "kp": config.kp,
            "kd": config.kd,
            "torque_limit": config.torque_limit * link.reduction,
            "speed_limit": config.speed_limit / link.reduction,
            "range": [float(bound) for bound in ranges[i]],
            "default": float(pose[i]),
        }
        for i, (name, link) in enumerate(zip(robot.layout.joints, robot.spec.links))
    ]


def measurements(observing: Any) -> list[dict[str, Any]]:
    """Describe what a robot has to measure in each control step, the inputs of the observation's graph.

    Args:
        observing: The graph.
    """
    found = []
    for name, shape in input_shapes(observing).items():
        if not name.startswith(MEMORY) and name not in (observe.BEGINS, observe.NOISE):
            meaning, unit, frame = MEASUREMENTS.get(name, (f"{name} of skatemount.envs.state.SimState", "", None))
            found.append({"name": name, "shape": shape, "meaning": meaning, "unit": unit, "frame": frame})
    return found


def memory(observing: Any) -> list[dict[str, Any]]:
    """Describe the memory of the observation's graph, which is zero at the start of an episode.

    Args:
        observing: The graph.
    """
    return [
        {"name": name.removeprefix(MEMORY), "shape": shape}
        for name, shape in input_shapes(observing).items()
        if name.startswith(MEMORY)
    ]


def _described(text: str) -> tuple[str, str, str | None]:
    """Return meaning, unit and frame that the first line of a term's docstring gives.

    Args:
        text: The line, such as ``Return the velocity of the trunk, trunk frame, [N, 3] m/s.``
    """
    shape, frame = _SHAPE.search(text), _FRAME.search(text)
    unit = ""
    if shape is not None:
        after = re.split(r"[.;,(]", text[shape.end() :])[0]
        unit = after.strip() if after.strip() in _UNITS else ""
        text = text[: shape.start()].rstrip(" ,") + text[shape.end() + (len(after) if unit else 0) :]
    return text.removeprefix("Return ").strip(" .,;"), unit, None if frame is None else frame.group(1)
