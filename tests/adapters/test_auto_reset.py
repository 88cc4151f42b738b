"""Worlds that begin new episodes by themselves: what a step returns at the end of an episode."""

from __future__ import annotations

import pytest
import torch

from skatemount.adapters.auto_reset import AutoResetEnv
from skatemount.envs import MountEnv, MountTask
from skatemount.utils.errors import ConfigError

SHORT = ["episode_length=0.2", "physics.threads=1"]


def test_the_steps_are_those_of_the_environment() -> None:
    adapted = AutoResetEnv("balance", 4, SHORT, seed=3)
    task = MountTask("balance", SHORT)
    env = MountEnv(task, num_worlds=4, seed=3, random_phase=True)
    state = env.reset()
    observation, privileged = adapted.reset()
    generator = torch.Generator().manual_seed(0)
    ended = 0
    for _ in range(12):
        assert torch.equal(observation, state["observation"]) and torch.equal(privileged, state["privileged"])
        action = torch.randn(4, 12, generator=generator)
        state["action"] = action
        step, state = env.step_and_maybe_reset(state)
        after = adapted.step(action)
        observation, privileged = after.observation, after.privileged
        assert torch.equal(after.reward, step["next", "reward"].squeeze(1))
        assert torch.equal(after.done, step["next", "done"].squeeze(1))
        assert torch.equal(after.final_observation, step["next", "observation"])
        assert torch.equal(after.final_privileged, step["next", "privileged"])
        # A world that goes on has the same observation in both places, one that ended has two.
        same = (after.observation == after.final_observation).all(1)
        assert torch.equal(same, ~after.done)
        ended += int(after.done.sum())
    assert ended >= 8


def test_a_seed_repeats_the_episodes() -> None:
    adapted = AutoResetEnv("balance", 2, SHORT)
    first = adapted.reset(seed=5)[0].clone()
    again = adapted.reset(seed=5)[0].clone()
    other = adapted.reset(seed=6)[0]
    assert torch.equal(first, again) and not torch.equal(first, other)


def test_what_a_library_asks_for() -> None:
    adapted = AutoResetEnv("balance", 2, SHORT)
    assert (adapted.num_envs, adapted.num_actions, adapted.max_episode_steps) == (2, 12, 5)
    observation, privileged = adapted.observations()
    assert observation.shape == (2, adapted.observation_size) and privileged.shape == (2, adapted.privileged_size)
    adapted.close()
    adapted.close()
    assert adapted.env.is_closed


def test_arguments_that_cannot_be_used() -> None:
    with pytest.raises(ConfigError, match="^num_envs=0 must be from 1"):
        AutoResetEnv("balance", 0, SHORT)
    for make in (
        lambda: AutoResetEnv("balance", 2, "board=longboard"),
        lambda: MountTask("balance", "board=longboard"),
    ):
        with pytest.raises(ConfigError, match=r"^overrides='board=longboard' must be a list .*\['board=longboard'\]"):
            make()
