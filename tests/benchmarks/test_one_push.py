"""`benchmarks/one_push.py`: what one push does to a robot that stands."""

from __future__ import annotations

from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
import torch
from scripts import load_script
from tensordict import TensorDict


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


def test_a_frozen_policy_repeats_its_last_action_from_the_push_on(script: ModuleType) -> None:
    class Counting:
        def actor_in(self, env: Any) -> Any:
            return lambda state: state.set("action", state["action"] + 1)

    env = SimpleNamespace(mdp=SimpleNamespace(context=SimpleNamespace(control_step=1.0)))
    act = script.Frozen(Counting()).actor_in(env)
    states = [TensorDict({"action": torch.tensor([float(10 * i)])}, []) for i in range(5)]
    assert [float(act(state)["action"]) for state in states] == [1.0, 11.0, 21.0, 21.0, 21.0]


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

    weak = kept("--fastest", "0.05")
    pushed = sum(robots for _, robots, _ in weak)
    assert {"along", "across"} == {direction for direction, _, _ in weak} and pushed >= 12
    assert sum(robots * share for _, robots, share in weak) >= 80 * pushed
    hard = [(robots, share) for direction, robots, share in kept("--fastest", "8") if direction == "across"]
    assert sum(robots * share for robots, share in hard) <= 50 * sum(robots for robots, _ in hard)
