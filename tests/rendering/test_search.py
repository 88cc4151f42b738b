"""The choice of the episodes to film: the first success, and the failures."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from filmed import filmed

from skatemount.config.suite import SuiteConfig
from skatemount.evaluation.records import EpisodeRecords
from skatemount.evaluation.suite_task import EvaluationTask
from skatemount.rendering.playback import replay_episodes
from skatemount.rendering.search import failures, first_success


def failing(*overrides: str, **kwargs: int) -> EvaluationTask:
    """Some of these are thrown over, and those that are not stand."""
    return filmed("balance-fixed", "start.ang_vel=[-6,6]", "episode_length=1.6", *overrides, policy="balance", **kwargs)


def first_of(records: EpisodeRecords) -> int:
    return int(records.number[records.success][0])


def test_the_first_success_is_chosen_and_the_failures_before_are_told() -> None:
    trial = failing("seed=6")
    records = trial.evaluate(6).records
    number = first_of(records)
    episode = first_success(trial)
    assert episode.number == number > 0
    assert "the first success; episode" in episode.choice and " failed: " in episode.choice
    evaluated, again = (vars(each) | each.metrics for each in (records[number : number + 1], episode.record))
    for name in evaluated.keys() - {"metrics"}:
        value, played = evaluated[name], again[name]
        assert torch.equal(played, value) or bool((played != played).all() and (value != value).all()), name
    (named,) = replay_episodes(trial, [number])
    assert named.choice == ""
    np.testing.assert_array_equal(named.frames[-1].qpos, episode.frames[-1].qpos)


def test_without_a_success_the_first_episode_is_filmed_with_its_end() -> None:
    episode = first_success(failing("termination.tilt.params.degrees=1"), 6)
    assert episode.number == 0
    assert episode.choice == "none of the first 6 episodes succeeded"
    assert episode.frames[-1].outcome == "failed: robot fell"
    assert not episode.frames[-1].succeeded


def test_variants_take_turns() -> None:
    """The lowest number counts, whichever variant it belongs to; the first variant never succeeds here."""
    base = failing()
    variants = {"never": ["termination.tilt.params.degrees=1"], "often": ["start.ang_vel=[0,0]"]}
    suite = SuiteConfig(name="test", stage="balance", overrides=["episode_length=1.6"], variants=variants)
    trial = EvaluationTask.of(base.agent, suite, ["physics.num_worlds=3", "physics.threads=1"])
    records = trial.evaluate(6).records
    episode = first_success(trial)
    assert episode.number == first_of(records)
    assert episode.number % 2 == 1


def test_no_more_than_the_first_episodes_are_searched() -> None:
    episode = first_success(failing("termination.tilt.params.degrees=1"), 2)
    assert episode.choice == "none of the first 2 episodes succeeded"


@pytest.mark.parametrize("parts", [1, 2])
def test_the_first_failures_are_found_over_rounds_and_variants(parts: int) -> None:
    suite = SuiteConfig(
        name="test",
        stage="balance",
        overrides=["episode_length=0.4"],
        variants={"a": ["start.ang_vel=[-6,6]"], "b": TIP},
    )
    trial = EvaluationTask.of(failing().agent, suite, ["physics.num_worlds=3", "physics.threads=1"])
    records = trial.evaluate(15).records
    failed = records.number[~records.success].tolist()
    episodes, said = failures(trial, 4, 15, parts)
    assert [episode.number for episode in episodes] == failed[:4]
    assert {episode.variant for episode in episodes} == {"a", "b"}
    assert all(episode.frames[-1].outcome.startswith("failed: ") and episode.parts == parts for episode in episodes)
    assert said.startswith(f"{len(failed)} of the first 15 episodes failed: ") and "robot fell" in said
    assert sum(int(word) for word in said.replace(",", "").split() if word.isdigit()) == 2 * len(failed) + 15


TIP = ["termination.tilt.params.degrees=1"]
