"""`Sb3Env`: the batched environment for Stable-Baselines3."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvIndices, VecEnvObs, VecEnvStepReturn

from skatemount.adapters.auto_reset import AutoResetEnv, Transition


class Sb3Env(VecEnv):
    """N worlds of a stage as a vectorized environment of Stable-Baselines3.

        model = PPO("MlpPolicy", Sb3Env("balance", num_envs=256), n_steps=24)
        model.learn(1_000_000)

    The worlds are one batch in this process. The ``info`` of an episode's last step has ``terminal_observation``,
    ``TimeLimit.truncated``, ``is_success``, and ``episode`` with return ``r``, length ``l`` and time ``t``, as
    Stable-Baselines3's ``VecMonitor`` would add.

    `AutoResetEnv` describes the other arguments and the errors.

    Args:
        privileged: True if observations also have the values that only a critic may get. A policy that reads them is an
            upper bound; no robot can measure them.
    """

    def __init__(
        self,
        stage: str,
        num_envs: int | None = None,
        overrides: Sequence[str] = (),
        seed: int = 0,
        privileged: bool = False,
    ):
        self.env = AutoResetEnv(stage, num_envs, overrides, seed)
        self._privileged = privileged
        size = self.env.observation_size + privileged * self.env.privileged_size
        bound, joints = self.env.action_bound, self.env.num_actions
        self.render_mode = None
        super().__init__(
            self.env.num_envs,
            spaces.Box(-np.inf, np.inf, (size,), np.float32),
            spaces.Box(-bound, bound, (joints,), np.float32),
        )
        self._actions = torch.zeros(self.num_envs, joints)
        self._returns, self._lengths = np.zeros(self.num_envs), np.zeros(self.num_envs, np.int64)
        self._begun = time.time()

    def reset(self) -> VecEnvObs:
        """Begin new episodes in all worlds, and return their observations, ``[N, D]``."""
        # Stable-Baselines3 gives every world a seed; here one seed draws everything.
        seed = self._seeds[0]
        self._reset_seeds()
        self._reset_options()
        self._returns[:], self._lengths[:] = 0.0, 0
        return self._joined(*self.env.reset(seed))

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions, ``[N, J]``, for `step_wait`."""
        self._actions = torch.from_numpy(np.ascontiguousarray(actions, np.float32))

    def step_wait(self) -> VecEnvStepReturn:
        """Advance all worlds by a control step, and begin new episodes where one ended.

        Returns:
            Observations ``[N, D]``, rewards ``[N]``, flags of episodes that ended ``[N]``, and an ``info`` per world.
        """
        after = self.env.step(self._actions)
        reward, done = after.reward.cpu().numpy(), after.done.cpu().numpy()
        self._returns += reward
        self._lengths += 1
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if done.any():
            self._describe(after, np.flatnonzero(done), infos)
            self._returns[done], self._lengths[done] = 0.0, 0
        return self._joined(after.observation, after.privileged), reward, done, infos

    def _describe(self, after: Transition, ended: np.ndarray, infos: list[dict[str, Any]]) -> None:
        """Write what Stable-Baselines3 reads of ended episodes into their infos."""
        final = self._joined(after.final_observation, after.final_privileged)
        truncated, success = after.truncated.cpu().numpy(), after.success.cpu().numpy()
        elapsed = round(time.time() - self._begun, 6)
        for i in ended:
            episode = {"r": round(float(self._returns[i]), 6), "l": int(self._lengths[i]), "t": elapsed}
            infos[i] = {
                "terminal_observation": final[i],
                "TimeLimit.truncated": bool(truncated[i]),
                "is_success": bool(success[i]),
                "episode": episode,
            }

    def _joined(self, observation: torch.Tensor, privileged: torch.Tensor) -> np.ndarray:
        values = torch.cat((observation, privileged), 1) if self._privileged else observation
        return values.cpu().numpy()

    def close(self) -> None:
        """Free the worlds."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute once for each chosen world, because all worlds are one object."""
        # Stable-Baselines3 asks before and after the constructor has run.
        value = getattr(self, attr_name) if hasattr(self, attr_name) else self.env.get(attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of the environment, for all worlds.

        Raises:
            ValueError: Only some worlds are chosen.
        """
        self._need_all("set_attr", indices)
        setattr(self.env.env, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any) -> list[Any]:
        """Call a method of the environment once, and return its result once for each world.

        Raises:
            ValueError: Only some worlds are chosen.
        """
        self._need_all("env_method", indices)
        result = self.env.get(method_name)(*args, **kwargs)
        return [result] * self.num_envs

    def env_is_wrapped(self, wrapper_class: type, indices: VecEnvIndices = None) -> list[bool]:
        """Return False for each chosen world: there are no wrappers around single worlds."""
        # `VecMonitor`'s information is part of this environment.
        from stable_baselines3.common.monitor import Monitor

        return [wrapper_class is Monitor for _ in self._get_indices(indices)]

    def _need_all(self, method: str, indices: VecEnvIndices) -> None:
        if len(list(self._get_indices(indices))) != self.num_envs:
            raise ValueError(f"{method}: indices={indices} must be None, because the worlds are one batch")
