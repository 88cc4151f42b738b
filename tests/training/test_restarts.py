"""A process that torchrun has restarted finds the run that it trained before."""

from __future__ import annotations

from pathlib import Path

import pytest

from skatemount.runs.folder import RunFolder
from skatemount.training.restarts import note_job, run_of_this_job


@pytest.fixture
def job(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    monkeypatch.setenv("TORCHELASTIC_RUN_ID", "none")
    monkeypatch.setenv("TORCHELASTIC_RESTART_COUNT", "0")
    return monkeypatch


def test_only_a_restart_of_the_same_job_finds_its_run(job: pytest.MonkeyPatch, tmp_path: Path) -> None:
    runs = [RunFolder.create(tmp_path, "a", name, {}, []) for name in ("one", "two")]
    note_job(runs[0])
    assert run_of_this_job(tmp_path) is None
    job.setenv("TORCHELASTIC_RESTART_COUNT", "1")
    assert run_of_this_job(tmp_path) == runs[0].path
    job.setenv("TORCHELASTIC_RUN_ID", "another")
    assert run_of_this_job(tmp_path) is None
    assert runs[0].remove_unused() and runs[1].remove_unused()


def test_without_torchrun_nothing_is_noted(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("TORCHELASTIC_RUN_ID", raising=False)
    run = RunFolder.create(tmp_path, "a", "one", {}, [])
    before = sorted(run.path.iterdir())
    note_job(run)
    assert sorted(run.path.iterdir()) == before and run_of_this_job(tmp_path) is None
