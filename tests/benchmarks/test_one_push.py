"""`benchmarks/one_push.py`: what one push does to a robot that stands."""

from __future__ import annotations

from types import ModuleType

import pytest
import torch
from scripts import load_script


@pytest.fixture(scope="module")
def script() -> ModuleType:
    return load_script("benchmarks/one_push.py")


def test_shares_are_those_of_a_direction_and_a_range(script: ModuleType) -> None:
    found = script.Pushes(
        speed=[torch.tensor([0.1, 0.3]), torch.tensor([0.1, 0.1])],
        across=[torch.tensor([False, True]), torch.tensor([True, True])],
        kept=[torch.tensor([True, False]), torch.tensor([True, False])],
        again=[torch.tensor([True, True]), torch.tensor([True, False])],
    )
    rows = {row[:3]: row[3:] for row in found.rows([0.0, 0.2, 0.4])}
    assert rows[False, 0.0, 0.2] == (1, 1.0, 1.0)
    assert rows[True, 0.0, 0.2] == (2, 0.5, 0.5)
    assert rows[True, 0.2, 0.4] == (1, 0.0, 1.0)
    assert rows[False, 0.2, 0.4][0] == 0


def test_a_weak_push_is_withstood_and_a_strong_one_is_not(
    script: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = ["--settings", "physics.threads=1", "physics.num_worlds=24", "start=on_deck"]

    def kept(*options: str) -> list[tuple[str, int, float]]:
        monkeypatch.setattr("sys.argv", ["x", "pretrained:balance", "--rounds", "1", *options, *settings])
        script.main()
        lines = capsys.readouterr().out.splitlines()[2:]
        cells = [[cell.strip() for cell in line.strip("| ").split("|")] for line in lines]
        assert [cell[0] for cell in cells] == ["balance"] * 16
        return [(cell[1], int(cell[3]), float(cell[4].removesuffix(" %"))) for cell in cells if cell[3] != "0"]

    weak, frozen = kept("--fastest", "0.05"), kept("--fastest", "0.05", "--frozen")
    pushed = sum(robots for _, robots, _ in weak)
    assert {"along", "across"} == {direction for direction, _, _ in weak} and pushed >= 12
    assert sum(robots * share for _, robots, share in weak) >= 80 * pushed
    # The same robots stood before the push.
    assert sum(robots for _, robots, _ in frozen) == pushed
    hard = [(robots, share) for direction, robots, share in kept("--fastest", "8") if direction == "across"]
    assert sum(robots * share for robots, share in hard) <= 50 * sum(robots for robots, _ in hard)
