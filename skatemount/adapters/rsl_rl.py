"""`RslRlEnv`: the batched environment for the runners of rsl_rl."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from rsl_rl.env import VecEnv
from tensordict import TensorDict
from torch import Tensor

from skatemount import config as configuration
from skatemount.adapters.auto_reset import AutoResetEnv


class RslRlEnv(VecEnv):
    """N worlds of a stage as an environment of rsl_rl (5.x).

        env = RslRlEnv("balance", num_envs=1024)
        OnPolicyRunner(env, train_cfg, log_dir).learn(100)

    The observations have the groups ``policy``, ``[N, D]``, and ``critic``, ``[N, P]``, the values that only the critic
    gets in addition. So ``obs_groups`` of the runner's settings is ``{"actor": ["policy"], "critic": ["policy",
    "critic"]}``. In ``extras``, ``time_outs`` marks truncated episodes, ``success`` those that succeeded, and ``log``
    has the same statistics as a training here, once every ``log_every`` steps.

    `AutoResetEnv` describes the other arguments and the errors.

    Args:
        log_every: Number of steps between two logged statistics.
    """

    def __init__(
        self,
        stage: str | None = None,
        num_envs: int | None = None,
        overrides: Sequence[str] = (),
        seed: int = 0,
        log_every: int = 24,
        config: configuration.TrainConfig | None = None,
    ):
        self._env = AutoResetEnv(stage, num_envs, overrides, seed, config)
        self.num_envs, self.num_actions = self._env.num_envs, self._env.num_actions
        self.max_episode_length = self._env.max_episode_steps
        self.device = self._env.env.device
        self.cfg = configuration.to_dict(self._env.config)
        self._log_every, self._steps = log_every, 0

    @property
    def unwrapped(self) -> RslRlEnv:
        """This environment, which wraps no other one of rsl_rl."""
        return self

    @property
    def episode_length_buf(self) -> Tensor:
        """``[N]`` int64: number of steps of each running episode. An assignment moves the episodes in time."""
        self._env.observations()
        return self._env.env.episode.step

    @episode_length_buf.setter
    def episode_length_buf(self, steps: Tensor) -> None:
        self._env.observations()
        self._env.env.episode.step = steps.to(self.device, torch.int64).clone()
        # These episodes did not begin at a start state of the stage.
        self._env.env.statistics.exclude_running()

    def get_observations(self) -> TensorDict:
        """Return the present observations by group."""
        return self._groups(*self._env.observations())

    def reset(self) -> tuple[TensorDict, dict[str, Any]]:
        """Begin new episodes in all worlds, and return the observations by group."""
        return self._groups(*self._env.reset()), {}

    def step(self, actions: Tensor) -> tuple[TensorDict, Tensor, Tensor, dict[str, Any]]:
        """Advance all worlds by a control step, and begin new episodes where one ended.

        Args:
            actions: ``[N, J]``.

        Returns:
            Observations by group, rewards ``[N]``, ``[N]`` int64 flags of episodes that ended, and extras.
        """
        after = self._env.step(actions)
        extras: dict[str, Any] = {"time_outs": after.truncated, "success": after.success}
        self._steps += 1
        if self._steps % self._log_every == 0 and (statistics := self._env.statistics()):
            extras["log"] = {f"/{name}": value for name, value in statistics.items()}
        return self._groups(after.observation, after.privileged), after.reward, after.done.long(), extras

    def close(self) -> None:
        """Free the worlds."""
        self._env.close()

    def _groups(self, observation: Tensor, privileged: Tensor) -> TensorDict:
        return TensorDict({"policy": observation, "critic": privileged}, [self.num_envs], device=self.device)
