"""Policies and checkpoints on disk. Nothing here reads pickle.

A *policy file* is `NAME.safetensors` with its card `NAME.json` beside it. A *checkpoint folder* is
`step_000001234567/` with `policy.safetensors`, `policy.json`, `training/`, the state that a resumed training needs, and
`worlds/`, the state of every world. Only the newest checkpoint of a run keeps its worlds, which take the most memory.
"""

from __future__ import annotations

import dataclasses
import json
import math
import typing
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from torch import Tensor, nn

from skatemount.runs import atomic
from skatemount.runs.serialization import load_state, parse_json, read_bytes, read_tensors, save_state, write_tensors
from skatemount.utils.errors import ConfigError, check_name

CARD_FORMAT = 1
POLICY_FILE = "policy.safetensors"
TRAINING_FOLDER = "training"
WORLDS_FOLDER = "worlds"

MAX_SIZE = 1_000_000
"""Largest number of values in an observation."""

MAX_JOINTS = 1000

_NON_FINITE = ("nan", "inf", "-inf")


@dataclass(kw_only=True)
class PolicyCard:
    """Description of a policy in plain values: enough to rebuild its network and its task.

    Attributes:
        format: Version of this layout.
        stage: The stage that it was trained in.
        config: The full resolved configuration of that training.
        observation: One dict for each part of the observation, in order (name, size, scale, …).
        action: Meaning of the actions (joint order, default pose, scale, clip, …).
        frames: Environment steps trained.
        metrics: Training metrics when it was saved.
        suites: Evaluation results by suite.
        versions: Versions of the packages that it was trained with.
        notes: Remarks for readers.
        sha256: Checksum of the weights' file; `save_policy` sets it.
    """

    format: int = CARD_FORMAT
    stage: str
    config: dict[str, Any]
    observation: list[dict[str, Any]] = field(default_factory=list)
    action: dict[str, Any] = field(default_factory=dict)
    frames: int = 0
    metrics: dict[str, Any] = field(default_factory=dict)
    suites: dict[str, Any] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=dict)
    notes: str = ""
    sha256: str = ""

    def to_json(self) -> str:
        """Return the card as strict JSON; numbers that are not finite become strings, other objects a `ConfigError`."""
        plain = {f.name: _plain(getattr(self, f.name), f.name) for f in dataclasses.fields(self)}
        return json.dumps(plain, indent=2, allow_nan=False, ensure_ascii=False) + "\n"

    @classmethod
    def from_json(cls, text: str | bytes, where: str = "card") -> PolicyCard:
        """Return a card from its JSON; `where` begins the `ConfigError` on a malformed one."""
        document = parse_json(text, where, CARD_FORMAT)
        kinds = {name: typing.get_origin(hint) or hint for name, hint in typing.get_type_hints(cls).items()}
        if unknown := sorted(set(document) - set(kinds)):
            raise ConfigError(f"{where}: unknown field {unknown[0]!r}; known: {', '.join(kinds)}")
        if missing := [name for name in ("stage", "config") if name not in document]:
            raise ConfigError(f"{where}: field {missing[0]!r} is missing")
        for name, value in document.items():
            if not isinstance(value, kinds[name]) or isinstance(value, bool):
                raise ConfigError(
                    f"{where}: field {name!r} is a {type(value).__name__}, a {kinds[name].__name__} is needed"
                )
        _check_card(document, where)
        return cls(**{name: _revive(value) for name, value in document.items()})


def _check_card(document: dict[str, Any], where: str) -> None:
    """Check names and sizes in a card, which may come from elsewhere.

    Raises:
        ConfigError: A name that could lead to another folder, or a size that no policy has.
    """
    check_name(f"{where}: stage", document["stage"])
    if not 0 <= document.get("frames", 0) < 2**62:
        raise ConfigError(f"{where}: frames={document['frames']} must be 0 or more, and less than 2**62")
    total = 0
    for i, part in enumerate(document.get("observation", []), 1):
        if not isinstance(part, dict):
            raise ConfigError(f"{where}: field 'observation' needs a list of objects")
        for name in ("key", "name"):
            if not isinstance(part.get(name), str):
                raise ConfigError(f"{where}: part {i} of its observation has {name}={part.get(name)!r}; text is needed")
        size = part.get("size")
        if type(size) is not int or not 1 <= size <= MAX_SIZE:
            raise ConfigError(f"{where}: part {i} of its observation has size={size!r}; 1 to {MAX_SIZE} are possible")
        frames = part.get("history_length", 1)
        if type(frames) is not int or not 1 <= frames <= size:
            raise ConfigError(f"{where}: part {i} of its observation has history_length={frames!r}; 1 to {size} needed")
        total += size
    if total > MAX_SIZE:
        raise ConfigError(f"{where}: its observation has {total} values; at most {MAX_SIZE} are possible")
    joints = document.get("action", {}).get("joints", [])
    if not isinstance(joints, list) or len(joints) > MAX_JOINTS or not all(isinstance(each, str) for each in joints):
        raise ConfigError(f"{where}: action.joints must be a list of at most {MAX_JOINTS} names")


def save_policy(path: Path, modules: Mapping[str, nn.Module], card: PolicyCard) -> None:
    """Write a policy file and its card.

    Args:
        path: The `.safetensors` file; the card goes beside it, ending in `.json`.
        modules: Networks by names without dots, such as ``{"actor": …, "critic": …}``; a weight's name in the file is
            ``actor.<parameter>``.
        card: The card; its `sha256` is filled in on disk.

    Raises:
        ConfigError: The path does not end in `.safetensors`, or the card holds other than plain data.
    """
    path = Path(path)
    if path.suffix != ".safetensors":
        raise ConfigError(f"{path}: a policy file ends in .safetensors")
    tensors = {f"{name}.{key}": v for name, module in modules.items() for key, v in module.state_dict().items()}
    card.to_json()  # a card that cannot be written must not leave weights without one
    digest = write_tensors(path, tensors)
    atomic.write_text(_card_path(path), dataclasses.replace(card, sha256=digest).to_json())


def load_policy(path: Path) -> tuple[dict[str, dict[str, Tensor]], PolicyCard]:
    """Return the state dicts of a policy by module name, on the CPU, and its card.

    Args:
        path: A `.safetensors` file, or a checkpoint folder.

    Raises:
        ConfigError: A file is missing, damaged, a pickle, or of a newer format, or a weight is not finite.
    """
    card = read_card(path)
    modules: dict[str, dict[str, Tensor]] = {}
    for name, tensor in read_tensors(_policy_file(path), card.sha256).items():
        if tensor.is_floating_point() and not tensor.isfinite().all():
            raise ConfigError(f"{_policy_file(path)}: weight {name} is not finite; the policy is of no use")
        module, _, key = name.partition(".")
        modules.setdefault(module, {})[key] = tensor
    return modules, card


def read_card(path: Path) -> PolicyCard:
    """Return the card of a policy file or checkpoint folder, without reading the weights.

    Raises:
        ConfigError: The policy or its card is missing, or the card is malformed.
    """
    card_path = _card_path(_policy_file(path))
    return PolicyCard.from_json(read_bytes(card_path), str(card_path))


def save_checkpoint(
    folder: Path,
    modules: Mapping[str, nn.Module],
    card: PolicyCard,
    training_state: Mapping[str, Any],
    world_state: Mapping[str, Any] | None = None,
) -> None:
    """Write a checkpoint folder, whole or not at all.

    Args:
        folder: Its final path (see `step_folder`); an existing one is replaced.
        modules: As for `save_policy`.
        card: As for `save_policy`.
        training_state: As for `skatemount.runs.serialization.save_state`.
        world_state: The same for the state of every world; not saved if None.

    Raises:
        ConfigError: A value cannot be saved; `folder` is as before.
    """
    with atomic.replacing_folder(Path(folder)) as staged:
        save_policy(staged / POLICY_FILE, modules, card)
        save_state(staged / TRAINING_FOLDER, training_state)
        if world_state is not None:
            save_state(staged / WORLDS_FOLDER, world_state)


def load_training_state(folder: Path) -> dict[str, Any]:
    """Return the training state of a checkpoint folder by its parts, tensors on the CPU.

    Raises:
        ConfigError: It is only a policy, or its state is missing or damaged.
    """
    state = Path(folder) / TRAINING_FOLDER
    if not state.is_dir():
        raise ConfigError(
            f"{folder}: has no training state to resume from; "
            "give a run or a checkpoint folder, or start from its policy with init_from"
        )
    return load_state(state)


def load_world_state(folder: Path) -> dict[str, Any] | None:
    """Return the state of every world of a checkpoint folder, or None if it has none, as all but the newest.

    Raises:
        ConfigError: The state is damaged.
    """
    state = Path(folder) / WORLDS_FOLDER
    return load_state(state) if state.is_dir() else None


def step_folder(frames: int) -> str:
    """Return a checkpoint folder's name, padded so that names sort by step."""
    return f"step_{frames:012d}"


def is_checkpoint(folder: Path) -> bool:
    """Return whether `folder` is a complete checkpoint folder."""
    return (folder / POLICY_FILE).is_file() and not folder.name.startswith(".")


def list_checkpoints(checkpoints: Path) -> list[Path]:
    """Return the checkpoint folders in `checkpoints`, the oldest first.

    The order is by time, not by step: a run that resumed from an earlier checkpoint writes smaller steps later.
    """
    return sorted(filter(is_checkpoint, checkpoints.glob("step_*")), key=_age)


def keep_last(checkpoints: Path, n: int, protect: Path | None = None) -> list[Path]:
    """Delete all but the newest checkpoints, and the worlds of all but the newest one.

    Args:
        checkpoints: The folder that holds them.
        n: Number to keep, at least 1.
        protect: A checkpoint that is kept in any case and not counted, such as the best one.

    Returns:
        The deleted checkpoints.

    Raises:
        ConfigError: `n` is less than 1.
    """
    if n < 1:
        raise ConfigError(f"keep={n}: at least 1 checkpoint has to be kept")
    protected = None if protect is None else Path(protect).resolve()
    doomed = [p for p in list_checkpoints(checkpoints) if p.resolve() != protected][:-n]
    for folder in doomed:
        atomic.remove_folder(folder)
    for folder in list_checkpoints(checkpoints)[:-1]:
        if (folder / WORLDS_FOLDER).is_dir():
            atomic.remove_folder(folder / WORLDS_FOLDER)
    return doomed


def _age(checkpoint: Path) -> tuple[int, str]:
    # Not the folder's own time, which changes when its worlds are deleted.
    return (checkpoint / POLICY_FILE).stat().st_mtime_ns, checkpoint.name


def _policy_file(path: Path) -> Path:
    path = Path(path)
    file = path / POLICY_FILE if path.is_dir() else path
    if file.suffix != ".safetensors":
        raise ConfigError(
            f"{file}: policies are read from .safetensors files only; "
            "pickle-based files such as .pt can run code when loaded and are refused"
        )
    if not file.is_file():
        raise ConfigError(f"{file}: there is no such policy file")
    return file


def _card_path(policy: Path) -> Path:
    return policy.with_suffix(".json")


def _plain(value: Any, where: str) -> Any:
    """Convert scalars of numpy and torch to Python's, and floats that are not finite to strings."""
    if isinstance(value, dict):
        return {str(key): _plain(item, f"{where}.{key}") for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item, f"{where}.{i}") for i, item in enumerate(value)]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else str(float(value))
    if value is None or isinstance(value, bool | int | str):
        return value
    if getattr(value, "ndim", None) == 0 and hasattr(value, "item"):
        return _plain(value.item(), where)
    raise ConfigError(f"card field {where}: a {type(value).__name__} is not plain data")


def _revive(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _revive(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_revive(item) for item in value]
    return float(value) if isinstance(value, str) and value in _NON_FINITE else value
