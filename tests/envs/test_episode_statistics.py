"""Means over ended episodes, against numbers worked out by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import defaults
import pytest
import torch

from skatemount.envs.episode_statistics import EpisodeStatistics
from skatemount.envs.mdp import StepResult
from skatemount.envs.state import EpisodeState

STEP = 0.1


def statistics(worlds: int, criterion: str = "mount") -> EpisodeStatistics:
    """Statistics of a task with two rewards, one termination and episodes of 10 steps of 0.1 s."""
    mdp: Any = SimpleNamespace(
        context=SimpleNamespace(control_step=STEP, episode_steps=10),
        criterion=criterion,
        rewards=SimpleNamespace(names=["alive", "effort"]),
        termination_names=lambda: ["tilt"],
        device=torch.device("cpu"),
    )
    return EpisodeStatistics(mdp, worlds)


def add(to: EpisodeStatistics, step: int, terms: list[list[float]], **given: Any) -> None:
    """Add a step to each world: `terms` by term and world, flags and the number of feet on the deck by world."""
    n = len(terms[0])

    def flag(name: str) -> torch.Tensor:
        return torch.tensor(given.get(name, [False] * n))

    episode = EpisodeState.zeros(n, defaults.LAYOUT)
    episode.step = torch.full((n,), step)
    episode.on_deck = torch.arange(4) < torch.tensor(given.get("feet", [0] * n)).unsqueeze(1)
    episode.first_contact = torch.full((n,), 0.2)
    episode.mounted_time = torch.full((n,), 0.1)
    values = torch.tensor(terms)
    terminated, truncated = flag("terminated"), flag("truncated")
    outcome = StepResult(values.sum(0), values, terminated.unsqueeze(0), terminated, truncated, flag("succeeded"))
    to.add(episode, outcome, terminated | truncated)


def test_without_an_ended_episode_there_are_no_metrics() -> None:
    found = statistics(2)
    add(found, 1, [[1.0, 1.0], [0.0, 0.0]])
    assert found.pop() == {}


def test_means_are_over_the_episodes_that_ended() -> None:
    found = statistics(3)
    add(found, 1, [[1.0, 1.0, 1.0], [-0.5, 0.0, 0.0]], feet=[4, 2, 0])
    # The first world succeeds, the second falls, the third goes on and does not count.
    ends = dict(truncated=[True, False, False], succeeded=[True, False, False], terminated=[False, True, False])
    add(found, 2, [[1.0, 1.0, 1.0], [-0.5, -3.0, 0.0]], feet=[4, 0, 0], **ends)
    assert found.pop() == pytest.approx(
        {
            "Train/mean_reward": ((2 - 1) + (2 - 3)) / 2,
            "Train/mean_episode_length": 2.0,
            "Success/rate": 0.5,
            "Success/feet_on_board": (4 + 1) / 2,
            "Success/time_to_mount": 0.0,
            "Episode_Reward/alive": 2.0 / 1.0,  # a second is the length of an episode
            "Episode_Reward/effort": (-1.0 - 3.0) / 2,
            "Episode_Termination/tilt": 0.5,
            "Episode_Termination/time_out": 0.5,
        }
    )


def test_pop_starts_new_sums_and_keeps_the_running_episodes() -> None:
    found = statistics(2)
    add(found, 1, [[1.0, 5.0], [0.0, 0.0]], terminated=[True, False])
    assert found.pop()["Train/mean_reward"] == 1.0
    assert found.pop() == {}
    add(found, 2, [[9.0, 2.0], [0.0, 0.0]], terminated=[False, True])
    assert found.pop()["Train/mean_reward"] == 7.0  # 5 from before the first `pop`


def test_a_reset_world_loses_its_running_episode() -> None:
    found = statistics(2)
    add(found, 1, [[5.0, 5.0], [0.0, 0.0]])
    found.restart(torch.tensor([True, False]))
    add(found, 2, [[1.0, 1.0], [0.0, 0.0]], terminated=[True, True])
    assert found.pop()["Train/mean_reward"] == (1.0 + 6.0) / 2


def test_excluded_episodes_do_not_count_and_their_successors_do() -> None:
    found = statistics(1)
    found.exclude_running()
    add(found, 1, [[5.0], [0.0]], terminated=[True])
    assert found.pop() == {}
    add(found, 1, [[2.0], [0.0]], terminated=[True])
    assert found.pop()["Train/mean_reward"] == 2.0


def test_time_to_mount_is_for_mounting_only() -> None:
    for criterion, expected in (("mount", True), ("gait", False)):
        found = statistics(1, criterion)
        add(found, 10, [[1.0], [0.0]], truncated=[True], succeeded=[True])
        metrics = found.pop()
        assert ("Success/time_to_mount" in metrics) == expected
        if expected:
            assert metrics["Success/time_to_mount"] == pytest.approx(10 * STEP - 0.1 - 0.2)
