"""`AutoResetEnv`: a `MountEnv` that begins new episodes within a step, as other libraries expect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

from skatemount.config import TrainConfig, compose
from skatemount.envs import MountEnv, MountTask
from skatemount.envs.config.physics import PhysicsConfig
from skatemount.utils.bounds import bounds_of


@dataclass
class Transition:
    """The result of a step of N worlds.

    Attributes:
        observation: ``[N, D]`` after the step; of a world whose episode ended, the first one of its next episode.
        privileged: ``[N, P]``, the same for the values that only a critic gets.
        reward: ``[N]``.
        terminated: ``[N]`` bool.
        truncated: ``[N]`` bool, ended by the time limit and not by a termination.
        success: ``[N]`` bool, the episode ended in this step and succeeded.
        final_observation: ``[N, D]`` after the step, before any new episode began.
        final_privileged: ``[N, P]``, the same for the privileged values.
    """

    observation: Tensor
    privileged: Tensor
    reward: Tensor
    terminated: Tensor
    truncated: Tensor
    success: Tensor
    final_observation: Tensor
    final_privileged: Tensor

    @property
    def done(self) -> Tensor:
        """``[N]`` bool: episodes that ended in this step."""
        return self.terminated | self.truncated


class AutoResetEnv:
    """N worlds of a stage that begin a new episode in the step in which the last one ended.

    The environments for other libraries take these arguments, too; their own docstrings have only the others.

    Args:
        stage: Name of a stage, such as ``"unfixed"``.
        num_envs: Number of worlds; ``physics.num_worlds`` of the stage if None.
        overrides: Further settings in Hydra's syntax, such as ``["board=longboard"]``.
        seed: Seed of all random numbers.
        config: Complete settings, in place of stage and overrides.

    Attributes:
        env: The environment.
        config: Its settings.

    Raises:
        ConfigError: The stage or a setting is unknown, or a setting has a value that cannot be used.
    """

    def __init__(
        self,
        stage: str | None = None,
        num_envs: int | None = None,
        overrides: Sequence[str] = (),
        seed: int = 0,
        config: TrainConfig | None = None,
    ):
        self.config = compose(stage, overrides) if config is None else config
        if num_envs is not None:
            # A setting of the physics, which the caller knows by another name.
            bounds_of(PhysicsConfig)["num_worlds"].check("num_envs", num_envs)
        self.env = MountEnv(MountTask(config=self.config), num_worlds=num_envs, seed=seed, random_phase=True)
        self._last: TensorDictBase | None = None

    @property
    def num_envs(self) -> int:
        """Number of worlds."""
        return self.env.num_worlds

    @property
    def observation_size(self) -> int:
        """Number of values in an observation."""
        return self.env.mdp.observation.size

    @property
    def privileged_size(self) -> int:
        """Number of values that only a critic gets."""
        return self.env.mdp.privileged.size

    @property
    def num_actions(self) -> int:
        """Number of actions."""
        return self.env.mdp.context.layout.num_joints

    @property
    def action_bound(self) -> float:
        """Largest size of an action; larger ones are clipped."""
        return self.env.task.scene.robot.config.action_clip

    @property
    def max_episode_steps(self) -> int:
        """Number of control steps after which an episode is truncated."""
        return self.env.mdp.context.episode_steps

    def reset(self, seed: int | None = None) -> tuple[Tensor, Tensor]:
        """Begin new episodes in all worlds.

        Args:
            seed: New seed of all random numbers; None continues with the present ones.

        Returns:
            ``[N, D]`` observations and ``[N, P]`` privileged values.
        """
        if seed is not None:
            self.env.set_seed(seed)
        self._last = self.env.reset()
        return self._last["observation"], self._last["privileged"]

    def observations(self) -> tuple[Tensor, Tensor]:
        """Return the present observations and privileged values; the first call begins the first episodes."""
        if self._last is None:
            return self.reset()
        return self._last["observation"], self._last["privileged"]

    def step(self, action: Tensor) -> Transition:
        """Advance all worlds by a control step, and begin new episodes where one ended.

        Args:
            action: ``[N, J]``.
        """
        self.observations()
        assert self._last is not None
        self._last["action"] = action.to(self.env.device, torch.float32)
        step, self._last = self.env.step_and_maybe_reset(self._last)
        following = step["next"]
        flags = {key: following[key].squeeze(1) for key in ("terminated", "truncated", "success")}
        return Transition(
            observation=self._last["observation"],
            privileged=self._last["privileged"],
            reward=following["reward"].squeeze(1),
            final_observation=following["observation"],
            final_privileged=following["privileged"],
            **flags,
        )

    def statistics(self) -> dict[str, float]:
        """Return the means over the episodes that ended since the last call, under the names that a training logs."""
        return self.env.statistics.pop()

    def close(self) -> None:
        """Free the worlds; a second call does nothing."""
        if not self.env.is_closed:
            self.env.close()

    def get(self, name: str) -> Any:
        """Return an attribute of the environment, or of this object."""
        return getattr(self.env, name) if hasattr(self.env, name) else getattr(self, name)
