"""Folder of a search: the same command finds it, and signs of life say which trials are trained."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from searched import settings_of

from skatemount.runs.locks import is_locked
from skatemount.searching.folder import SearchFolder, SignOfLife, open_folder
from skatemount.utils.errors import ConfigError

RANGE = "++search.space.algorithm.target_kl='log(0.001,0.1)'"


def test_the_same_command_has_the_same_folder(tmp_path: Path) -> None:
    dimensions = settings_of().dimensions()

    def name(*overrides: str) -> str:
        return open_folder(tmp_path, "search", overrides, dimensions).path.name

    first = name("stage=balance", "seed=1", RANGE)
    assert first.startswith("search_")
    same = ["torch_threads=1", "physics.threads=1", "search.trials=99", "search.stale_after=9", "logger.root=elsewhere"]
    assert name(RANGE, "seed=1", "stage=balance", *same) == first
    for other in (["seed=2"], ["seed=1", "search.sampler=random"], ["seed=1", "search.seed=1"]):
        assert name("stage=balance", *other, RANGE) != first
    assert open_folder(tmp_path, "search", ["stage=balance", "seed=1", RANGE], dimensions).is_old


def test_a_file_whose_space_has_changed_is_refused(make_folder: Callable[..., SearchFolder]) -> None:
    make_folder(settings_of())
    with pytest.raises(ConfigError) as error:
        make_folder(settings_of(space={"algorithm.epochs": "int(1,9)", "algorithm.target_kl": "log(0.001,0.1)"}))
    assert "search.space.algorithm.epochs=int(1,9): " in str(error.value)
    assert "was begun with int(1,8); logger.experiment=<another> starts afresh" in str(error.value)
    with pytest.raises(ConfigError, match="search.space.algorithm.target_kl=null: .* was begun with log"):
        make_folder(settings_of(space={"algorithm.epochs": "int(1,8)"}))


def test_a_sign_of_life_is_fresh_until_its_time_is_over(tmp_path: Path) -> None:
    path = tmp_path / "trials" / "trial_001.json"
    sign, other = SignOfLife(path), SignOfLife(path)
    assert not other.is_fresh(60)
    sign.take()
    assert other.is_fresh(60) and sign.is_mine and not other.is_mine
    old = path.stat().st_mtime - 100
    os.utime(path, (old, old))
    assert not other.is_fresh(60) and other.is_fresh(1000)
    other.take()
    assert other.is_mine and not sign.is_mine
    assert [each.name for each in path.parent.iterdir()] == ["trial_001.json"]


def test_a_process_of_this_machine_that_has_ended_gives_no_sign(tmp_path: Path) -> None:
    sign = SignOfLife(tmp_path / "trial_001.json")
    sign.take()
    ended = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, text=True)
    owner = json.loads(sign.path.read_text())
    sign.path.write_text(json.dumps(owner | {"process": int(ended.stdout)}))
    assert not sign.is_fresh(1000)
    # A process of another machine cannot be asked.
    sign.path.write_text(json.dumps(owner | {"process": int(ended.stdout), "machine": "other"}))
    assert sign.is_fresh(1000)


def test_a_kept_sign_is_touched_and_deleted_unless_it_is_anothers(tmp_path: Path) -> None:
    path = tmp_path / "trial_001.json"
    sign = SignOfLife(path)
    sign.take()
    os.utime(path, (1, 1))
    touched = SignOfLife._touch

    with sign.kept(120):
        assert path.exists()
    assert not path.exists()

    # The thread's own work, without its clock.
    sign.take()
    os.utime(path, (1, 1))
    waits = iter([False, True])
    sign._ended = type("Event", (), {"wait": lambda self, every: next(waits)})()  # type: ignore[assignment]
    touched(sign, 1)
    assert path.stat().st_mtime > 1

    with SignOfLife(path).kept(120):
        pass
    assert path.exists()  # another process's


def test_a_run_that_another_process_trains_is_locked(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    assert not is_locked(tmp_path / "run")
    code = (
        "import sys; from filelock import FileLock\n"
        "with FileLock(sys.argv[1]):\n    print('held', flush=True)\n    sys.stdin.read()\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path / "run" / ".lock")],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stdout is not None and process.stdout.readline() == "held\n"
    assert is_locked(tmp_path / "run")
    process.communicate("")
    assert not is_locked(tmp_path / "run")
