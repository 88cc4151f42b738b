"""The batched environment as a `VecEnv` of rsl_rl."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from rsl_rl.runners import OnPolicyRunner
from rsl_rl_settings import runner_settings

from skatemount.adapters.rsl_rl import RslRlEnv

SHORT = ["episode_length=0.4", "physics.threads=1"]


def test_groups_of_observations_and_ends_of_episodes() -> None:
    env = RslRlEnv("balance", 4, SHORT, log_every=10)
    groups = env.get_observations()
    assert set(groups.keys()) == {"policy", "critic"} and groups.batch_size == (4,)
    ended, logged = 0, []
    for _ in range(20):
        groups, reward, done, extras = env.step(torch.randn(4, 12))
        assert reward.shape == done.shape == (4,) and done.dtype == torch.int64
        assert bool((extras["time_outs"] <= done.bool()).all())
        ended += int(done.sum())
        logged += [extras["log"]] if "log" in extras else []
    # The first episodes begin in the middle, so they are not counted, and there is nothing to log after ten steps.
    assert ended >= 4 and len(logged) == 1 and "/Success/rate" in logged[0]


def test_lengths_of_episodes_can_be_set() -> None:
    env = RslRlEnv("balance", 3, SHORT)
    env.reset()
    env.episode_length_buf = torch.tensor([9, 0, 5])
    done = env.step(torch.zeros(3, 12))[2]
    assert done.tolist() == [1, 0, 0]
    assert env.episode_length_buf.tolist()[1:] == [1, 6]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_its_runner_learns_two_iterations(tmp_path: Path) -> None:
    env = RslRlEnv("balance", 8, SHORT)
    runner = OnPolicyRunner(env, runner_settings(steps=6, width=16), str(tmp_path), "cpu")
    policy = runner.get_inference_policy()
    first = policy(env.get_observations()).detach().clone()
    observations = env.get_observations().clone()
    runner.learn(2, init_at_random_ep_len=True)
    assert not torch.allclose(policy(observations), first)
