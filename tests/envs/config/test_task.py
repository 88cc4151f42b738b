"""Tables of terms in the task's settings, and the checks that concern more than one group."""

from __future__ import annotations

from typing import Any

import pytest

from skatemount.config import compose
from skatemount.envs.config.task import ObservationConfig
from skatemount.envs.config.terms import ObservationTerm, RewardTerm
from skatemount.utils.errors import ConfigError


def observation(policy: dict[str, Any] | None = None, privileged: dict[str, Any] | None = None) -> ObservationConfig:
    return ObservationConfig(policy=policy or {}, privileged=privileged or {}, noise=True, history_length=1)


def test_rows_become_dataclasses_with_defaults() -> None:
    given = ObservationTerm(scale=3.0)
    rows = observation({"gravity": {"noise": 1}, "command": None, "on_deck": given}).policy
    assert rows["gravity"] == ObservationTerm(noise=1.0)
    assert rows["command"] == ObservationTerm()
    assert rows["on_deck"] is given
    assert list(rows) == ["gravity", "command", "on_deck"]


@pytest.mark.parametrize(
    ("policy", "privileged", "expected"),
    [
        ({"gravity": 3}, {}, "observation.policy.gravity=3 must be the settings of a term: scale, noise, clip"),
        ({"gravity": {"nose": 1}}, {}, "observation.policy.gravity.nose=1 is not a setting of a term; known: scale"),
        ({}, {"heights": {"nose": 1}}, "observation.privileged.heights.nose=1 is not a setting of a term"),
        ({"gravity": {"scale": "big"}}, {}, "observation.policy.gravity={'scale': 'big'}: "),
    ],
)
def test_a_bad_row_is_one_line_that_names_it(policy: dict, privileged: dict, expected: str) -> None:
    with pytest.raises(ConfigError) as error:
        observation(policy, privileged)
    assert str(error.value).startswith(expected) and "\n" not in str(error.value)


def test_composed_tables_hold_dataclasses() -> None:
    config = compose("mount", ["reward.alive.weight=0.7"])
    assert config.reward["alive"] == RewardTerm(weight=0.7)
    assert all(isinstance(term, RewardTerm) for term in config.reward.values())


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("episode_length", 0.0, "episode_length=0.0 must be above 0 and at most 3600 s"),
        ("episode_length", float("inf"), "episode_length=inf must be above 0 and at most 3600 s"),
    ],
)
def test_the_tasks_own_settings_are_checked(name: str, value: object, expected: str) -> None:
    config = compose("mount")
    setattr(config, name, value)
    with pytest.raises(ConfigError) as error:
        config.validate()
    assert str(error.value) == expected


def test_an_unknown_task_is_refused_with_the_one_that_it_may_mean() -> None:
    config = compose("mount")
    config.success = "mout"
    with pytest.raises(ConfigError) as error:
        config.validate_terms()
    known = "gait, hold, mount, mount_and_ride, ride, ride_heading, ride_radius"
    assert str(error.value) == f"success=mout is not a known task (did you mean mount?); known: {known}"


def test_a_group_is_named_in_its_errors() -> None:
    config = compose("mount")
    config.start.edge_margin = -1.0
    with pytest.raises(ConfigError, match=r"^start\.edge_margin=-1\.0 must be"):
        config.validate()
