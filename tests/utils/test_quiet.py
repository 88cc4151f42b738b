"""Only the warnings of libraries that a user can do nothing about are ignored."""

from __future__ import annotations

import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from skatemount.utils.quiet import ignore_library_warnings


def test_other_warnings_are_still_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[str] = []
    monkeypatch.setattr(warnings, "showwarning", lambda message, *_: shown.append(str(message)))
    ignore_library_warnings()
    ignore_library_warnings()
    with warnings.catch_warnings():
        # As dm_control does when it is imported.
        warnings.simplefilter("always")
        warnings.warn(
            "Creating RayWeightUpdater which inherits from WeightUpdaterBase is deprecated. Please use another",
            DeprecationWarning,
            stacklevel=1,
        )
        warnings.warn("(65550) b'X11: The DISPLAY environment variable is missing'", UserWarning, stacklevel=1)
        warnings.warn("something else is deprecated", DeprecationWarning, stacklevel=1)
    assert shown == ["something else is deprecated"]


def test_a_mistake_is_all_that_a_program_prints(repo_root: Path) -> None:
    # The names of terms are checked after torch, TorchRL and dm_control have been imported.
    done = subprocess.run(
        [sys.executable, "-m", "skatemount.train", "stage=balance", "reward.alife.weight=1"],
        cwd=repo_root,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2 and done.stdout == ""
    assert (
        done.stderr.startswith("skatemount.train: reward.alife is not a known reward") and done.stderr.count("\n") == 1
    )
