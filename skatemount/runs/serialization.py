"""Training state on disk: one safetensors file of named tensors, and one JSON file of plain values. No pickle.

State is nested dicts. A tensor's name in the file is the path of keys that leads to it, joined by slashes:
``networks/normalizers.0.mean``, ``ppo/optimizer/actor.module.0.weight/exp_avg``. Both files have a SHA-256 checksum,
which is compared before anything is used.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import safetensors
import safetensors.torch
from torch import Tensor

from skatemount.runs import atomic, old_state
from skatemount.utils.errors import ConfigError

FORMAT = 2
TENSORS_FILE = "tensors.safetensors"
VALUES_FILE = "state.json"

_PICKLE_STARTS = (b"PK\x03\x04", b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05")


def save_state(folder: Path, state: Mapping[str, Any]) -> None:
    """Write training state to `tensors.safetensors` and `state.json`.

    Args:
        folder: The folder of the two files; created if missing.
        state: Dicts with string keys, nested to any depth, of tensors, numbers, strings, bools, None, and lists of
            these plain values. Values come back exactly; tensors come back on the CPU.

    Raises:
        ConfigError: A value of another type; the message names its place.
    """
    tensors: dict[str, Tensor] = {}
    values = _take_tensors(state, "", tensors)
    document = {
        "format": FORMAT,
        "tensors_sha256": write_tensors(folder / TENSORS_FILE, tensors),
        "state_sha256": _digest(values),
        "state": values,
    }
    atomic.write_text(folder / VALUES_FILE, json.dumps(document) + "\n")


def load_state(folder: Path) -> dict[str, Any]:
    """Return the state that `save_state` wrote, or an older version in its format.

    Args:
        folder: The folder given to `save_state`.

    Raises:
        ConfigError: A file is missing, damaged, or of a newer format; the message names it.
    """
    path = folder / VALUES_FILE
    document = parse_json(read_bytes(path), path, FORMAT)
    try:
        state = document["state"]
        if not isinstance(state, dict):
            raise ConfigError(f"{path}: its state is a {type(state).__name__}, a mapping is needed")
        if _digest(state) != document["state_sha256"]:
            raise ConfigError(f"{path}: damaged, the checksum of its state does not match")
        tensors = read_tensors(folder / TENSORS_FILE, document["tensors_sha256"])
        if document["format"] == 1:
            return old_state.to_parts(state, tensors)
        _put_tensors(state, tensors)
    except (KeyError, TypeError, AttributeError) as error:
        raise ConfigError(f"{path}: not a saved state ({error!r})") from error
    return state


def to_bytes(state: Mapping[str, Any]) -> bytes:
    """Return training state as bytes, for another process; see `save_state`."""
    tensors: dict[str, Tensor] = {}
    values = json.dumps(_take_tensors(state, "", tensors)).encode()
    return len(values).to_bytes(8, "little") + values + _tensor_bytes(tensors)


def from_bytes(data: bytes) -> dict[str, Any]:
    """Return the state of which `to_bytes` made the bytes, tensors on the CPU."""
    end = 8 + int.from_bytes(data[:8], "little")
    state: dict[str, Any] = json.loads(data[8:end])
    _put_tensors(state, safetensors.torch.load(data[end:]))
    return state


def write_tensors(path: Path, tensors: Mapping[str, Tensor]) -> str:
    """Write named tensors, of any device and layout, to a safetensors file, and return the file's SHA-256."""
    data = _tensor_bytes(tensors)
    atomic.write_bytes(path, data)
    return hashlib.sha256(data).hexdigest()


def read_tensors(path: Path, sha256: str) -> dict[str, Tensor]:
    """Return the tensors of a safetensors file, on the CPU.

    Args:
        path: The file.
        sha256: The checksum that `write_tensors` returned.

    Raises:
        ConfigError: The file is missing, a pickle, truncated or changed since it was written.
    """
    data = read_bytes(path)
    if data.startswith(_PICKLE_STARTS):
        raise ConfigError(f"{path}: a pickle under another name; it can run code and is refused")
    try:
        tensors = safetensors.torch.load(data)
    except (safetensors.SafetensorError, KeyError, ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        raise ConfigError(f"{path}: damaged or not a safetensors file of {len(data)} bytes ({reason})") from error
    if hashlib.sha256(data).hexdigest() != sha256:
        raise ConfigError(
            f"{path}: its checksum differs from the one saved with it; it is damaged or belongs to another card"
        )
    return tensors


def read_bytes(path: Path) -> bytes:
    """Return a file's content; a file that cannot be read is a `ConfigError` that names it."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from error


def parse_json(text: str | bytes, where: Path | str, newest: int | None = None) -> dict[str, Any]:
    """Return a JSON object from text.

    Args:
        text: The text.
        where: Its name in messages, such as the file's path.
        newest: If given, the object's ``format`` must be a whole number from 1 to this.

    Raises:
        ConfigError: It is something else.
    """
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{where}: damaged or not JSON ({error})") from error
    if not isinstance(document, dict):
        raise ConfigError(f"{where}: holds a {type(document).__name__}, a JSON object is needed")
    if newest is not None:
        found = document.get("format")
        if type(found) is not int or found < 1:
            raise ConfigError(f"{where}: format={found!r}, a whole number from 1 to {newest} is needed")
        if found > newest:
            raise ConfigError(f"{where}: format={found} is newer than {newest}, the newest this version reads")
    return document


def _digest(values: Any) -> str:
    return hashlib.sha256(json.dumps(values).encode()).hexdigest()


def _take_tensors(state: Mapping[str, Any], where: str, tensors: dict[str, Tensor]) -> dict[str, Any]:
    """Return the plain values of a nested state, and put its tensors into `tensors` by their paths."""
    values: dict[str, Any] = {}
    for key, value in state.items():
        if type(key) is not str or "/" in key:
            raise ConfigError(f"{where or 'state'}: the key {key!r} cannot be saved; strings without a slash can")
        place = f"{where}/{key}" if where else key
        if isinstance(value, Tensor):
            tensors[place] = value
        elif isinstance(value, Mapping):
            values[key] = _take_tensors(value, place, tensors)
        elif _is_plain(value):
            values[key] = value
        else:
            raise ConfigError(
                f"{place}: a {type(value).__name__} cannot be saved; tensors, numbers, strings, None, lists of plain "
                "values, and dicts of all of them can"
            )
    return values


def _put_tensors(state: dict[str, Any], tensors: Mapping[str, Tensor]) -> None:
    """Put tensors into a nested state, in place, by the paths that `_take_tensors` gave them."""
    for name, tensor in tensors.items():
        *groups, key = name.split("/")
        holder = state
        for group in groups:
            holder = holder[group]
        holder[key] = tensor


def _tensor_bytes(tensors: Mapping[str, Tensor]) -> bytes:
    """Return tensors of any device and layout in the format of a safetensors file."""
    owned = {name: tensor.detach().to("cpu", copy=True).contiguous() for name, tensor in tensors.items()}
    data: bytes = safetensors.torch.save(owned)
    return data


def _is_plain(value: Any) -> bool:
    # Exact types: a subclass, such as numpy's float64, would come back as its base.
    return (
        value is None or type(value) in (bool, int, float, str) or (type(value) is list and all(map(_is_plain, value)))
    )
