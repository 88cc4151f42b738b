"""Diverged worlds as files of plain arrays, and the control step in which one failed, done again in one world."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from skatemount.envs.divergence import DivergedWorld
from skatemount.utils.errors import ConfigError

FORMAT = 1
MODEL_FILE = "model.xml"

LARGEST = 1e10
"""Absolute value of a position, velocity or acceleration beyond which MuJoCo resets a world (mjMAXVAL)."""

_STATE = (
    "qpos",
    "qvel",
    "ctrl",
    "qacc_warmstart",
    "qfrc_applied",
    "xfrc_applied",
    "eq_active",
    "mocap_pos",
    "mocap_quat",
    "time",
    "history",
)
_GIVEN = ("qpos", "qvel", "ctrl", "qfrc_applied", "xfrc_applied", "mocap_pos", "mocap_quat")
# In the order in which MuJoCo computes them; those before the line follow from positions and velocities.
_FIRST = ("xpos", "xipos", "cinert", "actuator_length", "cvel", "qfrc_passive", "qfrc_bias")
_SECOND = (
    "actuator_force",
    "qfrc_actuator",
    "qacc_smooth",
    "efc_force",
    "qfrc_constraint",
    "qacc",
    "sensordata",
    "qvel",
    "qpos",
)
_BOUNDED = ("qpos", "qvel", "qacc")
_OF_BODIES = ("xpos", "xipos", "cinert", "cvel", "xfrc_applied")
_OF_ACTUATORS = ("ctrl", "actuator_length", "actuator_force")


@dataclass
class Finding:
    """The first quantity that is not finite, or too large.

    Attributes:
        substep: Physics step of the control step, from 1.
        quantity: Its name in ``MjData``, or ``model.<name>`` for a field of the model.
        index: Its index.
        where: The joint, body, actuator or sensor.
        value: Its value.
    """

    substep: int
    quantity: str
    index: int
    where: str
    value: float

    def __str__(self) -> str:
        return f"substep {self.substep}: {self.quantity}[{self.index}] of {self.where} is {self.value:g}"


@dataclass
class Replay:
    """Result of a replay.

    Attributes:
        finding: The first quantity that is not finite, or too large; None if there is none.
        qpos: ``[nq]`` positions after the last physics step that was done.
        qvel: ``[nv]`` velocities after it.
    """

    finding: Finding | None
    qpos: np.ndarray
    qvel: np.ndarray


def arrays_of(world: DivergedWorld) -> dict[str, np.ndarray]:
    """Return the arrays of a file: state and action before the step, and the fields in which the model differs."""
    arrays = {f"state.{name}": value for name, value in world.state.items()}
    arrays |= {f"model.{name}": value for name, value in _differing(world.model, world.nominal).items()}
    numbers = {"format": FORMAT, "world": world.world, "episode_step": world.episode_step, "substeps": world.substeps}
    arrays |= {name: np.array(value) for name, value in numbers.items()}
    return arrays | {"action": world.action, "targets": world.targets}


def _differing(model: mujoco.MjModel, nominal: mujoco.MjModel) -> dict[str, np.ndarray]:
    found = {}
    for name in dir(nominal):
        value = None if name.startswith("_") else getattr(nominal, name)
        if isinstance(value, np.ndarray) and value.dtype.kind == "f":
            own = getattr(model, name)
            if not np.array_equal(own, value, equal_nan=True):
                found[name] = own.copy()
    return found


def read(file: Path) -> tuple[mujoco.MjModel, dict[str, np.ndarray]]:
    """Read a diverged world.

    Args:
        file: The ``.npz`` file; the model lies beside it.

    Returns:
        Its model, and the arrays.

    Raises:
        ConfigError: A file is missing or holds something else.
    """
    try:
        with np.load(file, allow_pickle=False) as opened:
            arrays = {name: opened[name] for name in opened.files}
        xml = (file.parent / MODEL_FILE).read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{error.filename or file}: cannot be read ({error.strerror})") from error
    except (ValueError, zipfile.BadZipFile) as error:
        raise ConfigError(f"{file}: not a diverged world ({' '.join(str(error).split())})") from error
    try:
        if int(arrays["format"]) != FORMAT or not 1 <= int(arrays["substeps"]) <= 1000:
            raise ConfigError(f"{file}: format={arrays['format']} and substeps={arrays['substeps']} cannot be replayed")
        model = mujoco.MjModel.from_xml_string(xml)
        for name, value in arrays.items():
            kind, _, field = name.partition(".")
            if kind == "model":
                getattr(model, field)[...] = value
        _restore(mujoco.MjData(model), arrays)
    except (KeyError, ValueError, TypeError, AttributeError) as error:
        if isinstance(error, ConfigError):
            raise
        reason = " ".join(str(error).split())
        raise ConfigError(f"{file}: does not fit {MODEL_FILE} beside it, or was changed ({reason})") from error
    return model, arrays


def replay(model: mujoco.MjModel, arrays: dict[str, np.ndarray]) -> Replay:
    """Do the control step again in one world, with MuJoCo's C engine.

    Args:
        model: The world's model, which `read` returned.
        arrays: The arrays, which `read` returned.
    """
    # Else MuJoCo would put the world back to its default state, and nothing would be left to look at.
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    data = mujoco.MjData(model)
    _restore(data, arrays)
    finding = _of_model(model, arrays)
    for substep in range(1, int(arrays["substeps"]) + 1):
        finding = finding or _first(model, data, _GIVEN, substep)
        if finding is not None:
            break
        mujoco.mj_step1(model, data)
        finding = _first(model, data, _FIRST, substep)
        mujoco.mj_step2(model, data)
        finding = finding or _first(model, data, _SECOND, substep)
    return Replay(finding, data.qpos.copy(), data.qvel.copy())


def _restore(data: mujoco.MjData, arrays: dict[str, np.ndarray]) -> None:
    for name in _STATE:
        if (value := arrays.get(f"state.{name}")) is None:
            continue
        if name == "time":
            data.time = float(value)
        else:
            getattr(data, name)[...] = value


def _of_model(model: mujoco.MjModel, arrays: dict[str, np.ndarray]) -> Finding | None:
    for name, value in arrays.items():
        if name.startswith("model.") and not np.isfinite(value).all():
            index = int(np.flatnonzero(~np.isfinite(value).ravel())[0])
            row = index // max(1, value[0].size)
            where = _named(model, mujoco.mjtObj.mjOBJ_BODY, row) if name.startswith("model.body") else f"row {row}"
            return Finding(1, name, index, where, float(value.ravel()[index]))
    return None


def _first(model: mujoco.MjModel, data: mujoco.MjData, names: tuple[str, ...], substep: int) -> Finding | None:
    for name in names:
        values = np.asarray(getattr(data, name), np.float64)
        broken = ~np.isfinite(values)
        if name in _BOUNDED:
            broken |= np.abs(values) > LARGEST
        if broken.any():
            index = int(np.flatnonzero(broken.ravel())[0])
            return Finding(substep, name, index, _where(model, name, values, index), float(values.ravel()[index]))
    return None


def _where(model: mujoco.MjModel, name: str, values: np.ndarray, index: int) -> str:
    """Return the name of what a value belongs to."""
    objects = mujoco.mjtObj
    if name == "qpos":
        joint = int(np.flatnonzero(model.jnt_qposadr <= index)[-1])
        return _named(model, objects.mjOBJ_JOINT, joint)
    if name in _OF_BODIES:
        return _named(model, objects.mjOBJ_BODY, index // values[0].size)
    if name in _OF_ACTUATORS:
        return _named(model, objects.mjOBJ_ACTUATOR, index)
    if name == "sensordata":
        return _named(model, objects.mjOBJ_SENSOR, int(np.flatnonzero(model.sensor_adr <= index)[-1]))
    if values.shape == (model.nv,):
        return _named(model, objects.mjOBJ_JOINT, int(model.dof_jntid[index]))
    return "the constraints" if name == "efc_force" else "the scene"


def _named(model: mujoco.MjModel, kind: Any, i: int) -> str:
    """Return kind and name of an object; a joint with its body, because free joints often have no name."""
    words = {
        mujoco.mjtObj.mjOBJ_JOINT: "joint",
        mujoco.mjtObj.mjOBJ_BODY: "body",
        mujoco.mjtObj.mjOBJ_ACTUATOR: "actuator",
        mujoco.mjtObj.mjOBJ_SENSOR: "sensor",
    }
    text = f"{words[kind]} {mujoco.mj_id2name(model, kind, i) or i}"
    if kind == mujoco.mjtObj.mjOBJ_JOINT:
        body = int(model.jnt_bodyid[i])
        text += f" (body {mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, body) or body})"
    return text
