"""Compare what `dump.py` wrote for two versions."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

FILES = {
    "settings": "settings.json",
    "models": "model_*.npz",
    "steps": "step_*.npz",
    "updates": "update_*.npz",
    "policies": "policies.npz",
    "episodes": "episodes_*.npz",
    "weights": "weights_*.npz",
}
"""The files of each part."""

Translate = Callable[[dict[str, Any]], dict[str, Any]]


def compare_folders(theirs: Path, ours: Path, part: str, translate: Translate, tolerance: float = 0.0) -> list[str]:
    """Return what differs between two dumps of a part, one line each.

    Args:
        theirs: Folder of the older version's dump.
        ours: Folder of the newer version's.
        part: A key of `FILES`.
        translate: Takes the older version's settings and returns them under the newer version's names.
        tolerance: Largest absolute or relative difference of two numbers; at 0 every bit counts.
    """
    files = sorted(theirs.glob(FILES[part]))
    assert files, f"{theirs} has no {FILES[part]}"
    differences = []
    for file in files:
        found = _compare_json(file, ours / file.name, translate) if part == "settings" else _compare_arrays(
            file, ours / file.name, tolerance
        )  # fmt: skip
        differences += [f"{file.stem}: {line}" for line in found]
    return differences


def _compare_json(theirs: Path, ours: Path, translate: Translate) -> list[str]:
    old, new = (json.loads(path.read_text(encoding="utf-8")) for path in (theirs, ours))
    lines = []
    for line, values in old["trainings"].items():
        lines += [f"{line}: {each}" for each in _differing(translate(values), new["trainings"].get(line))]
    for name, variants in old["suites"].items():
        for variant, values in variants.items():
            found = _differing(translate(values), new["suites"].get(name, {}).get(variant))
            lines += [f"{name} {variant}: {each}" for each in found]
    return lines


def _differing(old: Any, new: Any, key: str = "") -> list[str]:
    """Return the keys whose values differ; numbers count by value, as 1 and 1.0 are the same setting."""
    if isinstance(old, dict) and isinstance(new, dict):
        lines = []
        for name in sorted(old.keys() | new.keys()):
            if name not in old or name not in new:
                lines.append(f"{key}{name}: only in the {'newer' if name not in old else 'older'} version")
            else:
                lines += _differing(old[name], new[name], f"{key}{name}.")
        return lines
    return [] if old == new else [f"{key.rstrip('.')}: {old!r} became {new!r}"]


def _compare_arrays(theirs: Path, ours: Path, tolerance: float) -> list[str]:
    lines = []
    with np.load(theirs) as old, np.load(ours) as new:
        for name in sorted(set(old.files) | set(new.files)):
            if name not in old.files or name not in new.files:
                lines.append(f"{name}: only in the {'newer' if name not in old.files else 'older'} version")
                continue
            a, b = old[name], new[name]
            if a.shape != b.shape:
                lines.append(f"{name}: shape {a.shape} became {b.shape}")
            elif not same(a, b, tolerance):
                numbers = a.dtype.kind in "fiu"
                how = f"largest difference {np.nanmax(np.abs(a.astype(float) - b))}" if numbers else "values"
                lines.append(f"{name}: {how}")
    return lines


def same(a: np.ndarray, b: np.ndarray, tolerance: float) -> bool:
    """Return whether two arrays are the same: to the bit at tolerance 0, but for the sign of zeros and kinds of nan."""
    if a.dtype.kind == "f" or b.dtype.kind == "f":
        if tolerance:
            return bool(np.allclose(a, b, rtol=tolerance, atol=tolerance, equal_nan=True))
        return bool(np.array_equal(a, b, equal_nan=True))
    return bool(np.array_equal(a, b))
