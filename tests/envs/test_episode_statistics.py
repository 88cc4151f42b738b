"""Means over ended episodes, against numbers worked out by hand."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import defaults
import pytest
import torch

from skatemount.envs.episode_statistics import EpisodeStatistics
from skatemount.envs.mdp import StepResult
from skatemount.envs.state import EpisodeState
from skatemount.envs.tasks import TASKS, Metric, TaskDefinition, TrainingValue
from skatemount.utils.errors import ConfigError

STEP = 0.1


def statistics(worlds: int, task: str | TaskDefinition = "mount") -> EpisodeStatistics:
    """Statistics of a task with two rewards, one termination and episodes of 10 steps of 0.1 s."""
    mdp: Any = SimpleNamespace(
        context=SimpleNamespace(control_step=STEP, episode_steps=10),
        definition=TASKS.get(task) if isinstance(task, str) else task,
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


def measuring(worlds: int, function: Callable[..., torch.Tensor], over: str = "end") -> EpisodeStatistics:
    """Statistics of a task with one value."""
    metric = Metric("height", "height", "height", function, training=TrainingValue(function, over))
    return statistics(worlds, TaskDefinition("made_up", "made up", function, "failed", "failed", (metric,)))


def test_values_are_those_of_the_task() -> None:
    values = {"mount": {"time_to_mount", "feet_on_board"}, "gait": {"velocity_error", "turn_error"}}
    for task, names in values.items():
        found = statistics(1, task)
        add(found, 10, [[1.0], [0.0]], truncated=[True], succeeded=[True])
        metrics = found.pop()
        assert {name for name in metrics if name.startswith("Success/")} == {
            "Success/rate",
            *(f"Success/{name}" for name in names),
        }
        if task == "mount":
            assert metrics["Success/time_to_mount"] == pytest.approx(10 * STEP - 0.1 - 0.2)


@pytest.mark.parametrize(("over", "expected"), [("steps", (1.5 + 1.5) / 2), ("end", 2.0), ("success", 2.0)])
def test_a_value_is_taken_over_the_steps_or_at_the_end(over: str, expected: float) -> None:
    found = measuring(3, lambda episode, context: episode.step.float(), over)
    add(found, 1, [[0.0] * 3] * 2)
    # The second world fails, the third goes on.
    ends = dict(truncated=[True, False, False], succeeded=[True, False, False], terminated=[False, True, False])
    add(found, 2, [[0.0] * 3] * 2, **ends)
    assert found.pop()["Success/height"] == expected


def test_without_a_success_there_is_no_value_of_successes() -> None:
    found = statistics(1)
    add(found, 1, [[0.0], [0.0]], terminated=[True])
    metrics = found.pop()
    assert "Success/time_to_mount" not in metrics and "Success/feet_on_board" in metrics


def test_a_value_that_is_not_finite_does_not_spoil_the_mean() -> None:
    found = measuring(2, lambda episode, context: torch.tensor([torch.nan, 4.0]))
    add(found, 1, [[0.0] * 2] * 2, terminated=[True, True])
    assert found.pop()["Success/height"] == 2.0


def test_a_value_of_the_wrong_shape_is_named() -> None:
    found = measuring(2, lambda episode, context: torch.zeros(2, 1))
    with pytest.raises(ConfigError, match=r"^metric 'height': training returned float32 of shape \[2, 1\]; .*\[2\]$"):
        add(found, 1, [[0.0] * 2] * 2)
