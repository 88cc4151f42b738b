"""Measurements of an episode, on constructed states."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import defaults
import pytest
import torch
from torch import Tensor

from skatemount.envs.mdp import StepResult
from skatemount.envs.state import EpisodeState
from skatemount.envs.tasks import TASKS
from skatemount.evaluation.records import EpisodeRecords, EpisodeTracker

STEP = 0.1
STEPS = 15  # 1.5 s, of which the last 10 steps count for the feet


def sim(foot_speed: list[float], board: float = 0.0, torque: float = 0.0, speed: float = 0.0) -> Any:
    """Return a state with the fields that the tracker reads, for two equal worlds."""
    velocity = torch.zeros(2, 4, 3)
    velocity[..., 1] = torch.tensor(foot_speed)
    return SimpleNamespace(
        foot_vel_board=velocity,
        board_pos=torch.tensor([[board, 0.0, 0.088]] * 2),
        board_fixed=torch.tensor([True, False]),
        joint_torque=torch.full((2, 12), torque),
        joint_vel=torch.full((2, 12), speed),
    )


class Script:
    """An environment of two worlds with given states."""

    num_worlds = 2

    def __init__(self) -> None:
        self.mdp = SimpleNamespace(
            context=SimpleNamespace(control_step=STEP, episode_steps=STEPS, layout=defaults.LAYOUT),
            definition=TASKS.get("mount"),
        )
        self.episode, self.sim = EpisodeState.zeros(2, defaults.LAYOUT), sim([0.0] * 4)
        self.episode.start = torch.tensor([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
        self.tracker = EpisodeTracker(self)  # type: ignore[arg-type]
        self.tracker.begin()

    def step(self, state: Any, feet: int = 4, ended: int | None = None, failed: bool = False) -> None:
        """Take a step; with `ended`, world 1 ends by the second termination, or by failed physics."""
        self.sim = state
        self.episode.step = self.episode.step + 1
        self.episode.on_deck = (torch.arange(4) < feet).expand(2, 4)
        ends = torch.zeros(3, 2, dtype=torch.bool)
        if ended is not None:
            ends[2 if failed else 1, 1] = True
        terminated = ends.any(0)
        truncated = (self.episode.step >= STEPS) & ~terminated
        nothing = torch.zeros(2)
        outcome = StepResult(nothing, nothing.unsqueeze(0), ends, terminated, truncated, truncated)
        self.tracker.add(self.episode, outcome, terminated | truncated)


def finish(script: Script) -> EpisodeRecords:
    while int(script.episode.step[0]) < STEPS:
        script.step(sim([0.0] * 4))
    assert script.tracker.finished
    return script.tracker.records(first=10)


def test_slips_are_counted_when_they_begin() -> None:
    script = Script()
    for speeds, feet in (
        ([0.3, 0.0, 0.0, 0.0], 4),  # one
        ([0.3, 0.4, 0.0, 0.0], 4),  # continues, and another begins
        ([0.0, 0.4, 0.0, 0.9], 3),  # continues; the fourth foot is in the air
        ([0.0, 0.0, 0.0, 0.9], 4),  # it lands sliding: a third
        ([0.3, 0.0, 0.0, 0.0], 4),  # the first foot again: a fourth
    ):
        script.step(sim(speeds), feet)
    assert finish(script).metrics["slips"].tolist() == [4, 4]


def test_an_episode_that_has_ended_is_not_measured_any_more() -> None:
    script = Script()
    busy = dict(torque=1.0, speed=1.0)
    script.step(sim([0.0] * 4, board=0.1, **busy))
    assert not script.tracker.finished
    script.step(sim([0.0] * 4, board=0.2, **busy), ended=1)
    assert script.tracker.has_ended(1) and not script.tracker.has_ended(0)
    for _ in range(STEPS - 2):
        script.step(sim([0.5] * 4, board=0.5, **busy), ended=1, failed=True)
    result = script.tracker.records(first=10)
    assert result.number.tolist() == [10, 11]
    assert result.start.tolist() == [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    assert result.board_fixed.tolist() == [True, False]
    assert result.success.tolist() == [True, False]
    assert result.end.tolist() == [0, 2]
    assert result.duration.tolist() == pytest.approx([1.5, 0.2])
    assert result.metrics["board_displacement"].tolist() == pytest.approx([0.5, 0.2])
    assert result.metrics["energy"].tolist() == pytest.approx([12 * 1.5, 12 * 0.2])
    assert result.metrics["slips"].tolist() == [4, 0]
    assert result.metrics["feet_on_board"].tolist() == [4.0, 0.0]


def test_feet_are_the_mean_of_the_last_second() -> None:
    script = Script()
    for step in range(STEPS):
        script.step(sim([0.0] * 4), feet=4 if step < 5 else 2 if step < 10 else 3)
    assert script.tracker.records(0).metrics["feet_on_board"].tolist() == [2.5, 2.5]


def test_what_a_failed_world_shows_is_not_counted() -> None:
    script = Script()
    script.step(sim([0.0] * 4, board=0.1))
    broken = sim([torch.nan] * 4, board=torch.inf, torque=torch.nan, speed=1.0)
    script.step(broken, ended=1, failed=True)
    result = script.tracker.records(0)
    assert (int(result.end[1]), float(result.metrics["energy"][1])) == (3, 0.0)
    assert float(result.metrics["board_displacement"][1]) == pytest.approx(0.1)


def test_records_are_joined_and_chosen() -> None:
    parts = [Script(), Script()]
    records = EpisodeRecords.cat([finish(part) for part in parts])
    assert len(records) == 4
    chosen: Tensor = records[records.number == 11].start
    assert chosen.tolist() == [[4.0, 5.0, 6.0]] * 2
