from __future__ import annotations

import os
from pathlib import Path

import pytest

from skatemount.runs.checkpoint import POLICY_FILE
from skatemount.runs.folder import RunFolder
from skatemount.runs.shipped import shipped_file, shipped_policies
from skatemount.viewer.actors import checkpoints_of, known_policies


def save(run: RunFolder, frames: int) -> Path:
    folder = run.checkpoint(frames)
    folder.mkdir()
    (folder / POLICY_FILE).touch()
    os.utime(folder, (frames, frames))
    return folder


def test_policies_and_checkpoints_that_there_are(runs_root: Path) -> None:
    assert known_policies(runs_root) == ["zero", "random", *shipped_policies()]
    run = RunFolder.create(runs_root, "skate", "one", {}, [])
    first, second = save(run, 10), save(run, 20)
    assert known_policies(runs_root)[-1] == str(run.path)
    for policy in (first, run.path):
        assert [Path(each).resolve() for each in checkpoints_of(policy)] == [second.resolve(), first.resolve()]
    part = run.create_part("1_gait", {}, [])
    third = save(part, 5)
    assert [Path(each).resolve() for each in checkpoints_of(run.path)] == [third.resolve()]


def test_a_shipped_policy_has_no_checkpoints() -> None:
    file = shipped_file("balance")
    assert file is not None and checkpoints_of(file) == []


@pytest.mark.parametrize("name", ["zero", "random"])
def test_simple_policies_are_offered_first(name: str, tmp_path: Path) -> None:
    assert name in known_policies(tmp_path)[:2]
