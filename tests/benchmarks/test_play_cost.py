"""Arithmetic of `benchmarks/play_cost.py`; its measurements need minutes."""

from __future__ import annotations

import subprocess
from pathlib import Path
from types import ModuleType

import pytest
from scripts import load_script


@pytest.fixture(scope="module")
def play_cost() -> ModuleType:
    return load_script("benchmarks/play_cost.py")


def test_a_turn_is_compared_with_its_neighbors_without_the_program(play_cost: ModuleType) -> None:
    """The machine becomes slower, which the ratio must not show."""
    kinds = [play_cost.ALONE, play_cost.CLOSED, play_cost.OPEN] * 2 + [play_cost.ALONE]
    speeds = [1000.0, 990.0, 450.0, 800.0, 700.0, 280.0, 600.0]
    turns = [play_cost.Turn(kind, speed, 0.1 * i, 1.0) for i, (kind, speed) in enumerate(zip(kinds, speeds))]
    found = play_cost.ratios(turns)
    assert found[play_cost.CLOSED] == pytest.approx([1.1, 1.0])
    assert found[play_cost.OPEN] == pytest.approx([0.5, 0.4])
    lines = play_cost.watch_table(turns).splitlines()
    assert lines[2:] == [
        "| no program | 800 | 1 | - | - |",
        "| no page open | 845 | 1.050 (1.000 to 1.100) | 0.25 | 1.00 |",
        "| page open | 365 | 0.450 (0.400 to 0.500) | 0.35 | 1.00 |",
    ]


def test_a_turn_lasts_from_iteration_to_iteration(play_cost: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    training = play_cost.Training.__new__(play_cost.Training)
    ends = iter([(10.0, 5000), (14.0, 7000)])
    used = iter([1.0, 20.0, 2.0, 26.0])
    monkeypatch.setattr(play_cost.Training, "iteration", lambda self: next(ends))
    monkeypatch.setattr(play_cost, "processor_times", lambda processes: next(used))
    turn = training.turn(play_cost.OPEN, 0.0, {1}, {2})
    assert turn == play_cost.Turn(play_cost.OPEN, speed=500.0, program=0.25, browser=1.5)


def test_a_training_that_ends_is_told(play_cost: ModuleType, tmp_path: Path) -> None:
    training = play_cost.Training(tmp_path, ["stage=nope"])
    with pytest.raises(RuntimeError, match="the training ended: .*there is no stage nope"):
        training.iteration()
    training.process.wait()


def test_a_process_that_does_not_end_is_ended_by_force(play_cost: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    process = subprocess.Popen(["sleep", "600"], text=True)
    monkeypatch.setattr(process, "terminate", lambda: None)
    waited = process.wait
    limits: list[float | None] = []

    def wait(timeout: float | None = None) -> int:
        limits.append(timeout)
        return waited(None if timeout is None else 0.0)

    monkeypatch.setattr(process, "wait", wait)
    play_cost.end(process)
    assert process.returncode == -9 and limits == [60, None]


def test_processes_are_found_with_those_that_they_start(play_cost: ModuleType) -> None:
    with subprocess.Popen(["sh", "-c", "sleep 60 & echo started; wait"], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        process.stdout.readline()
        found = play_cost.descendants(process.pid)
        assert process.pid in found and len(found) == 2
        assert 0 <= play_cost.processor_times(found) < 60
        for each in sorted(found - {process.pid}):
            subprocess.run(["kill", str(each)], check=True)
    assert play_cost.processor_times(found) == 0
