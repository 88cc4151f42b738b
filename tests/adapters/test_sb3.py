"""The batched environment as a `VecEnv` of Stable-Baselines3."""

from __future__ import annotations

import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy

from skatemount.adapters.sb3 import Sb3Env

SHORT = ["episode_length=0.4", "physics.threads=1"]


def test_infos_of_ended_episodes() -> None:
    env = Sb3Env("balance", 4, SHORT)
    observation = env.reset()
    assert observation.shape == (4, *env.observation_space.shape)
    returns, lengths, ended = np.zeros(4), np.zeros(4, int), 0
    for _ in range(22):
        observation, reward, done, infos = env.step(np.zeros((4, 12), np.float32))
        returns, lengths = returns + reward, lengths + 1
        for i in np.flatnonzero(done):
            ended += 1
            assert infos[i]["episode"]["l"] == lengths[i]
            assert infos[i]["episode"]["r"] == pytest.approx(returns[i], abs=1e-4)
            assert not np.array_equal(infos[i]["terminal_observation"], observation[i])
            assert isinstance(infos[i]["is_success"], bool)
            returns[i], lengths[i] = 0, 0
        assert all(not info for info, over in zip(infos, done) if not over)
    assert ended >= 8


def test_a_seed_repeats_the_episodes() -> None:
    env = Sb3Env("balance", 2, SHORT)
    first, again = [], []
    for found in (first, again):
        env.seed(4)
        found.append(env.reset())
    assert np.array_equal(first[0], again[0])


def test_privileged_values_on_request() -> None:
    plain, full = Sb3Env("balance", 2, SHORT), Sb3Env("balance", 2, SHORT, privileged=True)
    more = full.observation_space.shape[0] - plain.observation_space.shape[0]
    assert more == full.env.privileged_size
    assert full.reset().shape == (2, plain.env.observation_size + more)


def test_attributes_and_methods_of_all_worlds_only() -> None:
    env = Sb3Env("balance", 3, SHORT)
    assert env.get_attr("num_worlds") == [3, 3, 3] and env.get_attr("num_worlds", [0]) == [3]
    assert len(env.env_method("close")) == 3
    with pytest.raises(ValueError, match=r"set_attr: indices=\[0\] must be None"):
        env.set_attr("torch_threads", 1, [0])


def test_its_ppo_learns_and_evaluates() -> None:
    env = Sb3Env("balance", 8, SHORT)
    model = PPO("MlpPolicy", env, n_steps=8, batch_size=32, n_epochs=2, policy_kwargs={"net_arch": [16]}, device="cpu")
    before = model.policy.state_dict()["action_net.weight"].clone()
    model.learn(128)
    assert not bool((model.policy.state_dict()["action_net.weight"] == before).all())
    mean, _ = evaluate_policy(model, env, n_eval_episodes=8)
    assert np.isfinite(mean)
