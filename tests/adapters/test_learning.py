"""The trainers of other libraries learn to balance through the adapters."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from rsl_rl.runners import OnPolicyRunner
from rsl_rl_settings import runner_settings
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize
from stable_baselines3.common.vec_env.base_vec_env import VecEnv
from tensordict import TensorDict

import skatemount.adapters.gymnasium  # noqa: F401  # Registers the stages.
from skatemount.adapters.auto_reset import AutoResetEnv
from skatemount.adapters.rsl_rl import RslRlEnv
from skatemount.adapters.sb3 import Sb3Env

pytestmark = pytest.mark.slow

WORLDS, STEPS, ITERATIONS = 256, 24, 30
NOTHING, ENOUGH = 0.64, 0.7
"""Upper bound of the success of doing nothing, and lower bound after 184,320 environment steps."""
SETTINGS = ["physics.threads=1"]

Act = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]


def success_rate(act: Act) -> float:
    """Return the success of the second episode of each world; the first one begins at a random phase."""
    env = AutoResetEnv("balance", WORLDS, SETTINGS, seed=9)
    ended, succeeded = torch.zeros(WORLDS, dtype=torch.int64), torch.zeros(WORLDS, dtype=torch.bool)
    observation, privileged = env.reset()
    while bool((ended < 2).any()):
        after = env.step(act(observation, privileged))
        observation, privileged = after.observation, after.privileged
        ended += after.done
        succeeded |= after.success & (ended == 2)
    env.close()
    return float(succeeded.float().mean())


class OfVectorEnv(VecEnv):
    """A vector environment of Gymnasium for Stable-Baselines3, by the documented keys of its infos only."""

    def __init__(self, env: gymnasium.vector.VectorEnv):
        self.render_mode = None
        self._env = env
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def reset(self) -> np.ndarray:
        return self._env.reset(seed=0)[0]

    def step_async(self, actions: np.ndarray) -> None:
        self._step = self._env.step(actions)

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        observations, rewards, terminated, truncated, found = self._step
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(terminated | truncated):
            infos[i] = {"terminal_observation": found["final_obs"][i], "TimeLimit.truncated": bool(truncated[i])}
        return observations, rewards, terminated | truncated, infos

    def close(self) -> None:
        self._env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self, attr_name)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        raise NotImplementedError

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        raise NotImplementedError

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        return [False] * self.num_envs


def gymnasium_env() -> VecEnv:
    return OfVectorEnv(gymnasium.make_vec("skatemount/balance-v0", num_envs=WORLDS, overrides=SETTINGS))


def sb3_env() -> VecEnv:
    return Sb3Env("balance", WORLDS, SETTINGS)


@pytest.fixture(scope="module", autouse=True)
def doing_nothing() -> None:
    """Policies that are not trained do nothing, or worse."""
    assert success_rate(lambda observation, privileged: torch.zeros(WORLDS, 12)) < NOTHING


@pytest.mark.nightly
@pytest.mark.parametrize("make", [gymnasium_env, sb3_env])
def test_stable_baselines3_learns(make: Callable[[], VecEnv]) -> None:
    env = VecNormalize(make(), norm_reward=False)
    model = PPO(
        "MlpPolicy",
        env,
        n_steps=STEPS,
        batch_size=WORLDS * STEPS // 4,
        n_epochs=5,
        gamma=0.993,
        learning_rate=5e-4,
        target_kl=0.03,
        max_grad_norm=1.0,
        policy_kwargs={"net_arch": [128, 128], "activation_fn": torch.nn.ELU, "log_std_init": -1.4},
        device="cpu",
        seed=0,
    )
    model.learn(WORLDS * STEPS * ITERATIONS)

    def act(observation: torch.Tensor, privileged: torch.Tensor) -> torch.Tensor:
        return torch.from_numpy(model.predict(env.normalize_obs(observation.numpy()), deterministic=True)[0])

    after = success_rate(act)
    env.close()
    print(f"{make.__name__}: {after:.3f}")
    assert after >= ENOUGH


def test_rsl_rl_learns() -> None:
    torch.manual_seed(0)
    env = RslRlEnv("balance", WORLDS, SETTINGS)
    with contextlib.redirect_stdout(io.StringIO()):
        runner = OnPolicyRunner(env, runner_settings(STEPS, 128), None, "cpu")
    # The first policy of Stable-Baselines3 does nearly nothing, and that of rsl_rl acts at random.
    with torch.no_grad():
        runner.alg.actor.mlp[-1].weight.mul_(0.01)
    with contextlib.redirect_stdout(io.StringIO()):
        runner.learn(ITERATIONS)
    policy = runner.get_inference_policy()

    def act(observation: torch.Tensor, privileged: torch.Tensor) -> torch.Tensor:
        with torch.no_grad():
            return policy(TensorDict({"policy": observation, "critic": privileged}, [WORLDS]))

    after = success_rate(act)
    env.close()
    print(f"rsl_rl: {after:.3f}")
    assert after >= ENOUGH
