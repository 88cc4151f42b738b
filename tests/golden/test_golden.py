"""Today's numbers are those of commit 5ce7322, as far as another machine's rounding lets one say so.

`benchmarks/same_as.py` compares everything, bit for bit, on one machine.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import adapter
import dump
import golden_commands
import golden_compare
import numpy as np
import pytest

DATA = Path(__file__).parent / "data"
TOLERANCE = 1e-5
"""Largest difference that another processor's rounding may cause."""

WRITERS = {"settings": dump.settings, "models": dump.models, "steps": dump.steps, "updates": dump.updates}


@pytest.mark.parametrize("part", WRITERS)
def test_same_as_the_stored_data(part: str, tmp_path: Path) -> None:
    WRITERS[part](adapter, tmp_path)
    assert not golden_compare.compare_folders(DATA, tmp_path, part, adapter.translate, TOLERANCE)


@pytest.mark.parametrize("name", golden_commands.POLICIES)
def test_the_shipped_policies_are_the_old_ones(name: str) -> None:
    card = json.loads((DATA / "cards" / f"{name}.json").read_text(encoding="utf-8"))
    assert hashlib.sha256(adapter.policy_file(name).read_bytes()).hexdigest() == card["sha256"]


def test_the_shipped_policies_act_as_before(tmp_path: Path) -> None:
    dump.policies(adapter, tmp_path)
    assert not golden_compare.compare_folders(DATA, tmp_path, "policies", adapter.translate, TOLERANCE)


def test_a_difference_is_noticed(tmp_path: Path) -> None:
    """The comparison itself: one number changed by more than the tolerance, one array missing."""
    with np.load(DATA / "policies.npz") as stored:
        arrays = dict(stored)
    arrays["best"] = arrays["best"] + 1e-3
    del arrays["gait"]
    np.savez_compressed(tmp_path / "policies.npz", **arrays)
    found = golden_compare.compare_folders(DATA, tmp_path, "policies", adapter.translate, TOLERANCE)
    assert [line.split(":")[1].strip() for line in found] == ["best", "gait"]
