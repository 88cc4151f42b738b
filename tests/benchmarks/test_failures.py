"""`benchmarks/failures.py`: the kinds of failed episodes."""

from __future__ import annotations

from types import ModuleType

import pytest
import torch
from scripts import load_script


@pytest.fixture(scope="module")
def script() -> ModuleType:
    return load_script("benchmarks/failures.py")


def test_each_kind_is_told_from_the_others(script: ModuleType) -> None:
    steps, rows = 25, ("ended early", "hooked", "stepped off", "away", "other")
    feet = torch.tensor([[0, 3, 4, 0, 2]]).repeat(steps, 1)
    # The last robot touches something too, but for less than half of the time.
    touching = torch.tensor([[True, True, False, False, False]]).repeat(steps, 1)
    touching[:10, 4] = True
    longest = torch.tensor([0.0, 0.4, 2.0, 0.0, 0.9])
    early = torch.tensor([True, False, False, False, False])
    kinds = script.LastSecond(early, feet, touching, longest).kinds()
    assert tuple(script.KINDS[kind] for kind in kinds) == rows


def test_the_failures_of_a_suite_are_counted(
    script: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = ["--settings", "physics.threads=1", "physics.num_worlds=16", "episode_length=1.5"]
    monkeypatch.setattr("sys.argv", ["x", "pretrained:balance", "--suites", "approach-fixed", *settings])
    script.main()
    last = capsys.readouterr().out.splitlines()[-1]
    cells = [cell.strip() for cell in last.strip("| ").split("|")]
    assert cells[:3] == ["balance", "approach-fixed", "0.0 %"]
    assert sum(map(int, cells[3:])) == 16
