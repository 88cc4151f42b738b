"""Sweep folders: their names, their jobs, and the start of the same command for a second time."""

from __future__ import annotations

import datetime
import json
import os
import pickle
import re
from pathlib import Path
from typing import Any

import pytest
import torch

from skatemount.runs.checkpoint import POLICY_FILE, PolicyCard, save_policy
from skatemount.runs.find import find_checkpoint
from skatemount.runs.folder import RunFolder, age_key
from skatemount.runs.sweep import Job, Score, SweepFolder, analyze, identity, is_sweep, open_sweep
from skatemount.utils.errors import ConfigError

COMMAND = ["stage=balance", "algorithm.learning_rate=3e-4,1e-3", "seed=0,1"]


def job(sweep: SweepFolder, *settings: str, number: int = 1) -> Job:
    return sweep.job(number, ["stage=balance", *settings])


def add_checkpoint(run: RunFolder) -> Path:
    folder = run.checkpoint(10)
    save_policy(folder / POLICY_FILE, {"actor": torch.nn.Linear(1, 1)}, PolicyCard(stage="s", config={}))
    run.mark_checkpoint(folder, None)
    return folder


@pytest.fixture
def sweep(tmp_path: Path) -> SweepFolder:
    fixed, total = analyze(COMMAND)
    return SweepFolder(tmp_path / "runs" / "exp" / "2026-01-01_00-00-00_sweep", "train", fixed, total)


def test_a_job_is_named_after_the_settings_that_differ(sweep: SweepFolder) -> None:
    made = job(sweep, "algorithm.learning_rate=0.0003", "seed=1", number=2)
    assert made.label == "learning_rate=0.0003,seed=1"
    assert made.describe() == "job 2 of 4: algorithm.learning_rate=0.0003 seed=1"
    assert job(sweep).label == "run"
    assert job(sweep, "a.x=1", "b.x=2").label == "a.x=1,b.x=2"
    assert job(sweep, "++reward.near.weight=2", "~termination.tilt").label == "weight=2,tilt="
    assert job(sweep, "init_from='it\\'s, (ü)'").label == "init_from=it's, (ü)"


def test_names_that_do_not_fit_stay_different(sweep: SweepFolder) -> None:
    names = [
        job(sweep, f"init_from={each}").label for each in ("runs/a", "runs_a", "x" * 300, "x" * 301, f"'{'ü' * 300}'")
    ]
    assert len(set(names)) == 5 and names[1] == "init_from=runs_a"
    assert all("/" not in name and len(name.encode()) < 140 for name in names)


@pytest.mark.parametrize(
    ("overrides", "fixed", "total"),
    [
        (COMMAND, {"stage"}, 4),
        (["stage=balance", "seed=range(1,4)", "hydra/launcher=joblib"], {"stage"}, 3),
        (["+stage=balance,mount", "network.actor=[8,8]"], {"network.actor"}, 2),
        (["stage=balance", "seed=0,1", "hydra/sweeper=optuna"], {"stage"}, None),
        (["stage=glob(*)"], set(), None),
        (["resume='a,b'"], {"resume"}, 1),
    ],
)
def test_number_of_jobs(overrides: list[str], fixed: set[str], total: int | None) -> None:
    assert analyze(overrides) == (fixed, total)


def test_commands_that_train_the_same_are_the_same() -> None:
    same = identity(
        [
            "seed=0,1",
            *COMMAND[:2],
            "launcher=joblib",
            "torch_threads=1",
            "hydra/launcher=joblib",
            "hydra.launcher.n_jobs=2",
        ]
    )
    assert same == identity(COMMAND)
    assert identity([*COMMAND, "total_frames=9"]) != identity(COMMAND)
    assert identity([*COMMAND, "hydra.sweeper.params.seed=3"]) != identity(COMMAND)


def test_the_same_command_finds_its_folder_and_others_get_their_own(tmp_path: Path) -> None:
    def opened(arguments: list[str], repeat: bool = False) -> SweepFolder:
        with open_sweep(tmp_path, "x", "train", arguments, repeat) as sweep:
            job(sweep, "seed=1").write_record(Score.of(1, 2))
        return sweep

    first = opened(COMMAND)
    assert re.fullmatch(r"\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d_x", first.path.name) and not first.is_old
    assert is_sweep(first.path)
    again = opened(COMMAND)
    assert again.path == first.path and again.is_old
    assert len({first.path, opened([*COMMAND, "total_frames=9"]).path, opened(COMMAND, repeat=True).path}) == 3


def test_a_sweep_that_is_running_is_left_alone(tmp_path: Path) -> None:
    with open_sweep(tmp_path, "x", "train", COMMAND, False) as one:
        job(one, "seed=1").write_record(None)
        with open_sweep(tmp_path, "x", "train", COMMAND, False) as other:
            assert other.path != one.path and not other.is_old
        assert not other.path.exists()  # nothing was begun
    assert one.path.exists()


class OneMoment(datetime.datetime):
    """A clock that stands still."""

    @classmethod
    def now(cls, tz: Any = None) -> OneMoment:
        return cls(2026, 1, 2, 3, 4, 5, 6)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.parametrize("kind", ["run", "sweep"])
def test_processes_of_the_same_second_get_folders_of_their_own(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(datetime, "datetime", OneMoment)

    def begin() -> None:
        if kind == "run":
            RunFolder.create(tmp_path, "exp", "sweep", {"stage": {"name": "s"}}, [])
            return
        with open_sweep(tmp_path / "exp", "sweep", "train", COMMAND, repeat=True) as found:
            (found.path / "job").mkdir()
            (tmp_path / f"begun_{os.getpid()}").touch()
            while len(list(tmp_path.glob("begun_*"))) < 3:
                pass  # the others begin while this one runs

    children = []
    for _ in range(3):
        if not (child := os.fork()):
            status = 1
            try:
                begin()
                status = 0
            finally:
                os._exit(status)
        children.append(child)
    assert [os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) for child in children] == [0, 0, 0]
    names = sorted(path.name for path in (tmp_path / "exp").iterdir())
    assert names == [f"2026-01-02_03-04-05_sweep{suffix}" for suffix in ("", "_2", "_3")]
    marks = ("config.yaml", "git.diff") if kind == "run" else ("sweep.json", "job")
    assert all((tmp_path / "exp" / name / mark).exists() for name in names for mark in marks)


def test_damaged_files_of_a_sweep_are_passed_over(tmp_path: Path) -> None:
    with open_sweep(tmp_path, "x", "train", COMMAND, False) as first:
        job(first, "seed=1").write_record(None)
    (first.path / "jobs" / "seed=1.json").write_text("{")
    assert job(first, "seed=1").record() is None and first.records() == []
    (first.path / "sweep.json").write_text("[]")
    with open_sweep(tmp_path, "x", "train", COMMAND, False) as second:
        assert second.path != first.path


def test_a_job_knows_what_became_of_it(sweep: SweepFolder) -> None:
    made = job(sweep, "seed=1")
    assert made.record() is None and made.cut_off_run() is None and made.free_name() == "seed=1"
    run = sweep.create_part("seed=1", {}, made.overrides)
    assert made.cut_off_run() == run.path and made.free_name() == "seed=1_2"
    assert job(sweep, "seed=1", "total_frames=9").cut_off_run() is None  # the same name, other settings

    made.write_record(None, "broken", run.path)
    record = made.record()
    assert record is not None and (record["status"], record["error"], record["run"]) == ("failed", "broken", "seed=1")
    assert made.cut_off_run() is None

    second = sweep.create_part("seed=1_2", {}, [*made.overrides, "torch_threads=1"])
    assert made.cut_off_run() == second.path
    made.write_record(Score.of(3, 4, 1000, second.path))
    record = made.record()
    assert record is not None and made.cut_off_run() is None
    assert (record["success"], record["successes"], record["episodes"], record["steps"]) == (0.75, 3, 4, 1000)
    made.write_record(Score.of(0, 0, 1000, second.path))
    assert json.loads((sweep.path / "jobs" / "seed=1.json").read_text())["success"] is None  # no nan in JSON


def test_a_sweep_and_a_score_can_be_sent_to_another_process(sweep: SweepFolder) -> None:
    assert pickle.loads(pickle.dumps(sweep)) == sweep
    score = pickle.loads(pickle.dumps(Score.of(1, 4, 10, "x")))
    assert (score, score.episodes, score.frames, score.folder) == (0.25, 4, 10, "x")


def test_runs_of_a_sweep_take_part_in_latest(sweep: SweepFolder) -> None:
    root = sweep.path.parents[1]
    with open_sweep(root / "exp", "sweep", "train", COMMAND, False) as opened:
        first, second = (opened.create_part(name, {}, [name]) for name in ("seed=2", "seed=1"))
    assert age_key(first.path) < age_key(second.path)
    add_checkpoint(first)
    second_checkpoint = add_checkpoint(second)
    assert (root / "latest").read_text() == f"exp/{opened.path.name}/seed=1\n"
    assert find_checkpoint("latest", root) == second_checkpoint
    (root / "latest").unlink()
    assert find_checkpoint("latest", root) == second_checkpoint
    add_checkpoint(RunFolder.create(root, "exp", "balance", {}, []))
    assert find_checkpoint("latest", root).parents[1].name.endswith("_balance")
    with pytest.raises(ConfigError, match="a sweep; name one of its runs: .*seed=1, .*seed=2"):
        find_checkpoint(f"exp/{opened.path.name}", root)
