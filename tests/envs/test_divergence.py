"""Worlds whose physics fails are counted, and start states that fail at once are refused."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict

from skatemount.envs import MountEnv
from skatemount.envs.divergence import DivergedWorld
from skatemount.utils.errors import ConfigError

QUIET = ("randomization=none", "observation.noise=false")


def step(env: MountEnv) -> TensorDict:
    """A control step with zero actions; worlds that ended begin new episodes."""
    actions = TensorDict({"action": torch.zeros(env.action_spec.shape)}, env.batch_size)
    return env.step_and_maybe_reset(actions)[1]


def spoil(env: MountEnv, *worlds: int) -> None:
    mask = torch.zeros(env.num_worlds, dtype=torch.bool)
    mask[list(worlds)] = True
    env.physics.push(mask, torch.full((env.num_worlds, 3), torch.nan))


def test_each_failure_is_counted_once(make_env) -> None:
    env = make_env("balance", 4, QUIET)
    env.reset()
    step(env)
    spoil(env, 1, 3)
    actions = TensorDict({"action": torch.zeros(env.action_spec.shape)}, env.batch_size)
    for _ in range(3):
        env.step(actions.copy())  # without a reset, they stay as they are
    assert env.divergence.pop() == {"Train/diverged_worlds": 2.0}
    env.reset()
    spoil(env, 1)
    step(env)
    spoil(env, 1)
    step(env)
    assert env.divergence.pop() == {"Train/diverged_worlds": 2.0}
    step(env)
    assert env.divergence.pop() == {"Train/diverged_worlds": 0.0}


def test_starts_that_fail_at_once_are_one_line(make_env) -> None:
    env = make_env("balance", 16, (*QUIET, "start.height=[0.5,1.0]"))
    env.reset()
    spoil(env, *range(8))
    with pytest.raises(ConfigError) as error:
        step(env)
    text = str(error.value)
    assert text.startswith("start states diverge at once: the physics of 8 of 16 new episodes (50%) failed")
    assert "start.height=[0.5, 1.0]" in text and "physics.timestep=0.01" in text and "\n" not in text


def test_a_few_among_many_are_only_counted(make_env) -> None:
    env = make_env("balance", 40, QUIET)
    env.reset()
    for _ in range(3):
        spoil(env, 0, 1, 2)
        step(env)
    # 9 of 46 new episodes; later failures of an episode say nothing about its start.
    for _ in range(3):
        step(env)
    spoil(env, *range(40))
    step(env)
    assert env.divergence.pop()["Train/diverged_worlds"] == 49


def test_old_episodes_are_forgotten(make_env) -> None:
    env = make_env("balance", 4, QUIET)
    env.reset()
    env.divergence._begun = 10_000.0
    with pytest.raises(ConfigError, match="diverge at once"):
        for _ in range(200):
            spoil(env, 0, 1, 2, 3)
            step(env)


def test_a_watcher_gets_the_state_before_the_step_until_it_has_enough(make_env) -> None:
    env = make_env("balance", 4, ("randomization.trunk_mass=[0.5,1.0]",))
    env.reset()
    step(env)
    seen: list[DivergedWorld] = []

    def watch(world: DivergedWorld) -> bool:
        seen.append(world)
        return len(seen) < 2

    env.divergence.watch(watch)
    step(env)
    assert not seen
    env.physics.field("body_mass")[2] *= 1.0
    before = env.physics.raw_state()
    spoil(env, 0, 2, 3)
    step(env)
    assert [world.world for world in seen] == [0, 2]
    assert env.divergence._watcher is None and env.divergence._before is None
    copied = seen[1]
    assert copied.episode_step == 2 and copied.substeps == 4
    assert (copied.state["qpos"] == before[2, 1 : 1 + len(copied.state["qpos"])]).all()
    assert copied.state["ctrl"][env.physics.index.actuators].tolist() == copied.targets.tolist()
    trunk = env.physics.index.trunk_body
    assert copied.model.body_mass[trunk] == env.physics.field("body_mass")[2, trunk] != copied.nominal.body_mass[trunk]
