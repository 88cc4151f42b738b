"""The stages as environments of Gymnasium."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import skatemount.adapters.gymnasium as adapter
from skatemount.config.files import choices
from skatemount.utils.errors import ConfigError

SHORT = ["episode_length=0.2", "physics.threads=1"]


def vector(num_envs: int = 4, **kwargs: object) -> gymnasium.vector.VectorEnv:
    return gymnasium.make_vec("skatemount/balance-v0", num_envs=num_envs, overrides=SHORT, **kwargs)


def test_every_stage_is_registered_once() -> None:
    adapter.register_stages()
    names = {name for name in gymnasium.registry if name.startswith("skatemount/")}
    assert names == {f"skatemount/{stage}-v0" for stage in choices("stage")}


def test_an_environment_names_its_module() -> None:
    env = gymnasium.make_vec("skatemount.adapters.gymnasium:skatemount/balance-v0", num_envs=2, overrides=SHORT)
    assert isinstance(env, adapter.GymnasiumVectorEnv) and env.num_envs == 2


# Gymnasium warns of boxes without bounds, which observations are.
@pytest.mark.filterwarnings("ignore:.*Box observation space:UserWarning")
def test_one_world_passes_the_checker_of_gymnasium() -> None:
    env = gymnasium.make("skatemount/unfixed-v0", overrides=["physics.threads=1"])
    check_env(env.unwrapped, skip_render_check=True)
    env.close()


def test_the_last_step_of_one_world_tells_of_success() -> None:
    env = gymnasium.make("skatemount/balance-v0", overrides=SHORT)
    env.reset(seed=1)
    for step in range(5):
        _, _, terminated, truncated, info = env.step(np.zeros(12, np.float32))
        assert ("success" in info) == (terminated or truncated) == (step == 4)


def test_a_vector_of_worlds() -> None:
    env = vector()
    observations, infos = env.reset(seed=2)
    assert observations.shape == env.observation_space.shape == (4, *env.single_observation_space.shape)
    assert infos["privileged"].shape[0] == 4
    ended = 0
    for _ in range(11):
        actions = env.action_space.sample()
        observations, rewards, terminated, truncated, infos = env.step(actions)
        done = terminated | truncated
        assert env.observation_space.contains(observations) and rewards.shape == (4,)
        assert ("final_obs" in infos) == done.any()
        if done.any():
            ended += int(done.sum())
            last = infos["final_obs"]
            assert [row is not None for row in last] == done.tolist() == infos["_final_obs"].tolist()
            world = int(np.flatnonzero(done)[0])
            assert last[world].shape == observations[world].shape
            assert not np.array_equal(last[world], observations[world])
            assert infos["final_info"]["success"].shape == (4,)
    assert ended >= 8


def test_the_episodes_of_a_vector_repeat_with_the_seed() -> None:
    env = vector()
    assert np.array_equal(env.reset(seed=7)[0], env.reset(seed=7)[0])


def test_what_cannot_be_done_is_refused() -> None:
    with pytest.raises(ConfigError, match="render_mode='human' must be None"):
        adapter.GymnasiumVectorEnv("balance", 2, SHORT, render_mode="human")
    with pytest.raises(ValueError, match="reset_mask must be true everywhere"):
        vector(2).reset(options={"reset_mask": np.array([True, False])})
    with pytest.raises(gymnasium.error.Error, match="balanse"):
        gymnasium.make("skatemount/balanse-v0")
    with pytest.raises(ConfigError, match="bord"):
        adapter.GymnasiumVectorEnv("balance", 2, ["bord=mini"])
