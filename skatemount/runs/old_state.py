"""Training state of format 1, read as the named parts of today."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from torch import Tensor

_NORMALIZED = ("actor.", "critic.")
"""Networks whose inputs the first and the second normalizer belong to."""


def to_parts(structure: Any, tensors: Mapping[str, Tensor]) -> dict[str, Any]:
    """Return the parts of a training state.

    Args:
        structure: The JSON content. A dict with one key that begins with ``$`` stands for a tensor, tuple, float or a
            dict whose keys are no strings.
        tensors: The tensors that it refers to.

    Raises:
        KeyError: It is not such a state.
    """
    state = _decode(structure, tensors)
    networks = dict(state["networks"])
    for i, behind in enumerate(state.get("behind", [])):
        # One count for all features was saved, and apart from it the samples that each feature had missed.
        for key in networks:
            if key.endswith(".count") and key.startswith((_NORMALIZED[i], f"normalizers.{i}.")):
                networks[key] = networks[key] - behind
    optimizer = state["ppo"]["optimizer"]
    parts = {
        "networks": networks,
        "ppo": {
            "learning_rate": optimizer["param_groups"][0]["lr"],
            "optimizer": {str(i): values for i, values in optimizer["state"].items()},
        },
        "env": {"generator": state["env_rng"]},
        "generators": {"torch": state["torch_rng"], "minibatches": state["order_rng"]},
        "progress": {key: state[key] for key in ("frames", "iteration", "elapsed", "device") if key in state},
        "callbacks": {},
    }
    return parts | ({} if state["curriculum"] is None else {"curriculum": state["curriculum"]})


def _decode(value: Any, tensors: Mapping[str, Tensor]) -> Any:
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
