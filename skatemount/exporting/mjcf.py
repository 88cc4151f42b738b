"""The scene of a task as MJCF, with its own motors or with plain PD motors."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from typing import Any

import mujoco
import numpy as np

from skatemount.envs.entities.quadruped import KD_INDEX, KP_INDEX
from skatemount.envs.scene import Scene, SceneIndex

OLDEST = {"scene.xml": "3.12.0", "scene_pd.xml": "3.3.5"}
"""Oldest MuJoCo that opened the scenes of A1 and Go2 when the releases from 3.3.2 to 3.17 were tried; the releases
before these two lack the motor's ``input="pos"``, and contact sensors."""

_OF_DC_MOTORS = ("dyntype", "gaintype", "biastype", "input", "actearly", "dynprm", "gainprm", "forcerange")
_OF_LATE_TARGETS = ("delay", "nsample", "interp")


def portable(xml: str) -> str:
    """Return a scene without an attribute that MuJoCo below 3.17 does not know and that changes nothing.

    Args:
        xml: The scene as MJCF.
    """
    root = ElementTree.fromstring(xml)
    for texture in root.iter("texture"):
        # Textures have no defaults that a class could name.
        texture.attrib.pop("class", None)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def plain_motors(xml: str, model: mujoco.MjModel, index: SceneIndex) -> str:
    """Return a scene whose motors are PD controllers with a limit of the torque.

    Their torque is ``clip(kp (target - angle) - kd speed, -T, T)``. Unlike the scene's own motors they have no limit
    that depends on the speed, and their targets are never late.

    Args:
        xml: The scene as MJCF.
        model: The scene compiled.
        index: Ids of the scene.
    """
    root = ElementTree.fromstring(xml)
    for default in root.iter("default"):
        for general in default.findall("general"):
            if general.get("dyntype") == "dcmotor":
                _remove(general, _OF_DC_MOTORS)
    motors = {model.actuator(i).name: int(i) for i in index.actuators}
    for general in root.iter("general"):
        if (number := motors.get(general.get("name", ""))) is not None:
            gains, limits = model.actuator_gainprm[number], model.actuator_forcerange[number]
            kp, kd = gains[KP_INDEX], gains[KD_INDEX]
            _remove(general, (*_OF_DC_MOTORS, *_OF_LATE_TARGETS))
            general.attrib |= {
                "gaintype": "fixed",
                "biastype": "affine",
                "gainprm": _written([kp]),
                "biasprm": _written([0.0, -kp, -kd]),
                "forcelimited": "true",
                "forcerange": _written(limits),
            }
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def scene_names(scene: Scene, model: mujoco.MjModel, index: SceneIndex) -> dict[str, Any]:
    """Return the names of what a simulation of the scene sets, and the sizes that it can check.

    Args:
        scene: The scene.
        model: The scene compiled.
        index: Ids of the scene.
    """
    wheels = [joint.full_identifier for joint in scene.board.wheel_joints]
    return {
        "actuators": [model.actuator(i).name for i in index.actuators],
        "joints": [joint.full_identifier for joint in scene.robot.joints],
        "robot_joint": scene.robot_frame.freejoint.full_identifier,
        "board_joint": scene.board_frame.freejoint.full_identifier,
        "board_body": model.body(index.board_body).name,
        "wheel_joints": wheels,
        "weld": scene.weld.full_identifier,
        "floor": scene.arena.robot_floor.full_identifier,
        "sensordata": int(model.nsensordata),
    }


def _remove(element: ElementTree.Element, names: tuple[str, ...]) -> None:
    for name in names:
        element.attrib.pop(name, None)


def _written(values: Any) -> str:
    return " ".join(repr(float(value)) for value in np.asarray(values))
