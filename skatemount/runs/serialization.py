"""Nested Python state on disk without pickle: tensors in safetensors, structure in JSON.

Reading executes nothing: JSON gives only plain values, safetensors only numbers, and both are
checked against a SHA-256 before they are used. TorchRL's own `Checkpoint` keeps state in the same
spirit, but picks the format by what lies in the folder, so that a prepared folder can still make it
unpickle (`tensordict.load` of a memory map with an `other.pickle`, `torch.load` of a `.pt`); and it
neither flushes nor checks what it wrote.
"""

from __future__ import annotations

import hashlib
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import safetensors
import safetensors.torch
import torch
from torch import Tensor

from skatemount.runs import atomic
from skatemount.utils.errors import ConfigError

FORMAT = 1
TENSORS_FILE = "tensors.safetensors"
STRUCTURE_FILE = "state.json"

_PICKLE_STARTS = (b"PK\x03\x04", b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05")


def save_state(folder: Path, state: dict[str, Any]) -> None:
    """Writes nested state to `folder`.

    Args:
        folder: Where to put `tensors.safetensors` and `state.json`; made if missing.
        state: Dicts, lists and tuples, nested as you like, of tensors, numpy arrays and scalars,
            ints, floats, bools, strings and None. Dict keys are strings, ints, or tuples of these.
            Types, dtypes, shapes and values come back exactly; tensors come back on the CPU.

    Raises:
        ConfigError: Something of another type is in it; the message says where.
    """
    tensors: dict[str, Tensor] = {}
    structure = _encode(state, "state", tensors)
    digest = write_tensors(folder / TENSORS_FILE, tensors)
    body = json.dumps(structure, allow_nan=False)
    document = {
        "format": FORMAT,
        "tensors_sha256": digest,
        "state_sha256": hashlib.sha256(body.encode()).hexdigest(),
        "state": structure,
    }
    atomic.write_text(folder / STRUCTURE_FILE, json.dumps(document, allow_nan=False) + "\n")


def load_state(folder: Path) -> dict[str, Any]:
    """Reads what `save_state` wrote.

    Args:
        folder: The folder given to `save_state`.

    Returns:
        The state, tensors on the CPU.

    Raises:
        ConfigError: A file is missing, damaged, or of a newer format; the message names it.
    """
    path = folder / STRUCTURE_FILE
    document = parse_json(read_bytes(path), path)
    check_format(document, FORMAT, path)
    try:
        structure = document["state"]
        digest = hashlib.sha256(json.dumps(structure).encode()).hexdigest()
        if digest != document["state_sha256"]:
            raise ConfigError(f"{path}: damaged, the checksum of its state does not match")
        tensors = read_tensors(folder / TENSORS_FILE, document["tensors_sha256"])
        return _decode(structure, tensors)
    except (KeyError, TypeError) as error:
        raise ConfigError(f"{path}: not a saved state ({error!r})") from error


def write_tensors(path: Path, tensors: dict[str, Tensor]) -> str:
    """Writes named tensors to a safetensors file in one step.

    Args:
        path: The file.
        tensors: Tensors of any device and layout; each gets its own bytes, shared memory or not.

    Returns:
        SHA-256 of the file, in hexadecimal.
    """
    owned = {name: tensor.detach().to("cpu", copy=True).contiguous() for name, tensor in tensors.items()}
    data = safetensors.torch.save(owned)
    atomic.write_bytes(path, data)
    return hashlib.sha256(data).hexdigest()


def read_tensors(path: Path, sha256: str) -> dict[str, Tensor]:
    """Reads a safetensors file, and nothing that is not one.

    Args:
        path: The file.
        sha256: What `write_tensors` returned.

    Returns:
        The tensors by name, on the CPU.

    Raises:
        ConfigError: It is missing, a pickle, truncated or changed since it was written.
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
            f"{path}: its checksum is not the one noted when it was saved; it is damaged or belongs to another card"
        )
    return tensors


def read_bytes(path: Path) -> bytes:
    """Reads a file.

    Raises:
        ConfigError: It cannot be read; the message names it.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from error


def parse_json(text: str | bytes, where: Path | str) -> dict[str, Any]:
    """Reads a JSON object from text; `where` names it in errors.

    Raises:
        ConfigError: It is not a JSON object.
    """
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{where}: damaged or not JSON ({error})") from error
    if not isinstance(document, dict):
        raise ConfigError(f"{where}: holds a {type(document).__name__}, a JSON object is needed")
    return document


def check_format(document: dict[str, Any], known: int, where: Path | str) -> None:
    """Refuses a document of a format that this version does not know.

    Raises:
        ConfigError: The format is missing, not a positive whole number, or newer than `known`.
    """
    found = document.get("format")
    if type(found) is not int or found < 1:
        raise ConfigError(f"{where}: format={found!r}, a whole number from 1 to {known} is needed")
    if found > known:
        raise ConfigError(f"{where}: format={found} is newer than {known}, the newest this version reads")


def _encode(value: Any, where: str, tensors: dict[str, Tensor]) -> Any:
    # Exact types on purpose: np.float64 is a float and OrderedDict a dict, but only the second may
    # be stored as its base.
    if value is None or type(value) in (bool, int, str):
        return value
    if type(value) is float:
        return value if math.isfinite(value) else {"$float": str(value)}
    if type(value) is list:
        return [_encode(item, f"{where}.{i}", tensors) for i, item in enumerate(value)]
    if isinstance(value, tuple):
        return {"$tuple": [_encode(item, f"{where}.{i}", tensors) for i, item in enumerate(value)]}
    if isinstance(value, dict):
        items = {key: _encode(item, f"{where}.{key}", tensors) for key, item in value.items()}
        if all(type(key) is str and not key.startswith("$") for key in items):
            return items
        return {"$dict": [[_encode_key(key, where), item] for key, item in items.items()]}
    if isinstance(value, Tensor):
        return {"$tensor": _store(value, where, tensors)}
    if isinstance(value, np.ndarray | np.generic):
        tag = "$array" if isinstance(value, np.ndarray) else "$scalar"
        try:
            return {tag: _store(torch.from_numpy(np.array(value)), where, tensors)}
        except (TypeError, ValueError) as error:
            raise ConfigError(f"{where}: numpy dtype {value.dtype} cannot be saved") from error
    raise ConfigError(
        f"{where}: a {type(value).__name__} cannot be saved; tensors, arrays, numbers, strings, "
        "None, and lists, tuples and dicts of them can"
    )


def _encode_key(key: Any, where: str) -> Any:
    if isinstance(key, tuple):
        return {"$tuple": [_encode_key(part, where) for part in key]}
    if type(key) in (str, int):
        return key
    raise ConfigError(f"{where}: a dict key {key!r} cannot be saved; strings and ints can")


def _store(tensor: Tensor, where: str, tensors: dict[str, Tensor]) -> str:
    name = where
    if name in tensors:  # {"a.b": x, "a": {"b": y}} asks for the same name twice
        name = f"{where}#{len(tensors)}"
    tensors[name] = tensor
    return name


def _decode(value: Any, tensors: dict[str, Tensor]) -> Any:
    if isinstance(value, list):
        return [_decode(item, tensors) for item in value]
    if not isinstance(value, dict):
        return value
    tag = next(iter(value), "")
    if not tag.startswith("$"):
        return {key: _decode(item, tensors) for key, item in value.items()}
    content = value[tag]
    match tag:
        case "$float":
            return float(content)
        case "$tuple":
            return tuple(_decode(item, tensors) for item in content)
        case "$dict":
            return {_decode(key, tensors): _decode(item, tensors) for key, item in content}
        case "$tensor":
            return tensors[content]
        case "$array":
            return tensors[content].numpy()
        case "$scalar":
            return tensors[content].numpy()[()]
    raise KeyError(tag)
