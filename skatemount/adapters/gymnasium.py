"""The stages as environments of Gymnasium: ``skatemount/<stage>-v0``, registered when this module is imported."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from skatemount.adapters.auto_reset import AutoResetEnv
from skatemount.config.files import choices
from skatemount.envs import MountEnv, MountTask
from skatemount.utils.errors import ConfigError

VERSION = 0


class GymnasiumVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """N worlds of a stage as one vector environment.

        import gymnasium
        import skatemount.adapters.gymnasium

        env = gymnasium.make_vec("skatemount/unfixed-v0", num_envs=256)

    An episode begins in the step in which the last one ended (``AutoresetMode.SAME_STEP``). In that step ``infos`` has
    ``final_obs``, an array of objects with the last observation of each episode that ended, and ``final_info`` with
    ``privileged`` and ``success`` of these worlds. ``infos["privileged"]``, ``[N, P]``, has the values that only a
    critic may get.

    `AutoResetEnv` describes the other arguments and the errors.

    Args:
        render_mode: Must be None; ``python -m skatemount.record`` films a policy.
    """

    metadata = {"autoreset_mode": AutoresetMode.SAME_STEP, "render_modes": []}

    def __init__(
        self, stage: str, num_envs: int = 1, overrides: Sequence[str] = (), render_mode: str | None = None
    ) -> None:
        _refuse_rendering(render_mode)
        self._env = AutoResetEnv(stage, num_envs, overrides)
        self.num_envs = num_envs
        self.single_observation_space = _observations(self._env.env)
        self.single_action_space = _actions(self._env.env)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.metadata = self.metadata | {"render_fps": round(1 / self._env.env.mdp.context.control_step)}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin new episodes in all worlds.

        Args:
            seed: New seed of all random numbers; None continues with the present ones.
            options: None, or ``reset_mask`` with ``[N]`` bool, which must be true everywhere.

        Raises:
            ValueError: ``reset_mask`` leaves worlds out; the environment begins their episodes by itself.
        """
        super().reset(seed=seed)
        mask = (options or {}).get("reset_mask")
        if mask is not None and not np.all(mask):
            raise ValueError("reset_mask must be true everywhere: episodes that ended begin again within the step")
        observation, privileged = self._env.reset(seed)
        return observation.numpy(force=True), {"privileged": privileged.numpy(force=True)}

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Advance all worlds by a control step, and begin new episodes where one ended.

        Args:
            actions: ``[N, J]``.

        Returns:
            Observations ``[N, D]``, rewards, terminated and truncated flags ``[N]``, and infos.
        """
        after = self._env.step(torch.from_numpy(np.ascontiguousarray(actions, np.float32)))
        done = after.done.numpy(force=True)
        infos: dict[str, Any] = {"privileged": after.privileged.numpy(force=True)}
        if done.any():
            last = after.final_observation.numpy(force=True)
            infos["final_obs"] = np.array([row if ended else None for row, ended in zip(last, done)] + [None], object)
            infos["final_obs"] = infos["final_obs"][:-1]
            infos["final_info"] = {
                "privileged": after.final_privileged.numpy(force=True),
                "success": after.success.numpy(force=True),
            }
            infos["_final_obs"] = infos["_final_info"] = done
        terminated, truncated = after.terminated.numpy(force=True), after.truncated.numpy(force=True)
        return after.observation.numpy(force=True), after.reward.numpy(force=True), terminated, truncated, infos

    def close_extras(self, **kwargs: Any) -> None:
        """Free the worlds."""
        self._env.close()


class GymnasiumEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One world of a stage, for `gymnasium.make`.

    ``info`` has ``privileged``, ``[P]``, and after the last step ``success``. A single world is slow; `make_vec` steps
    many at once.

    The arguments are those of `GymnasiumVectorEnv`, without the number of worlds.
    """

    metadata = {"render_modes": []}

    def __init__(self, stage: str, overrides: Sequence[str] = (), render_mode: str | None = None) -> None:
        _refuse_rendering(render_mode)
        self._env = MountEnv(MountTask(stage, overrides), num_worlds=1)
        self.observation_space = _observations(self._env)
        self.action_space = _actions(self._env)
        self._last = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin a new episode; see `gymnasium.Env.reset`."""
        super().reset(seed=seed)
        if seed is not None:
            self._env.set_seed(seed)
        self._last = self._env.reset()
        return self._values(self._last)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Advance by a control step; see `gymnasium.Env.step`."""
        assert self._last is not None, "reset must be called before step"
        self._last["action"] = torch.from_numpy(np.ascontiguousarray(action, np.float32)).unsqueeze(0)
        following = self._env.step(self._last)["next"]
        self._last = following.select("observation", "privileged")
        observation, info = self._values(following)
        terminated, truncated = bool(following["terminated"]), bool(following["truncated"])
        if terminated or truncated:
            info["success"] = bool(following["success"])
        return observation, float(following["reward"]), terminated, truncated, info

    def close(self) -> None:
        """Free the world; a second call does nothing."""
        if not self._env.is_closed:
            self._env.close()

    def _values(self, state: Any) -> tuple[np.ndarray, dict[str, Any]]:
        return state["observation"][0].numpy(force=True), {"privileged": state["privileged"][0].numpy(force=True)}


def _observations(env: MountEnv) -> spaces.Box:
    return spaces.Box(-np.inf, np.inf, (env.mdp.observation.size,), np.float32)


def _actions(env: MountEnv) -> spaces.Box:
    bound = env.task.scene.robot.config.action_clip
    return spaces.Box(-bound, bound, (env.mdp.context.layout.num_joints,), np.float32)


def _refuse_rendering(mode: str | None) -> None:
    if mode is not None:
        raise ConfigError(f"render_mode={mode!r} must be None; python -m skatemount.record films a policy")


def register_stages() -> None:
    """Register every stage that is not registered yet; call it again after `skatemount.config.set_user_config_dir`."""
    for stage in choices("stage"):
        name = f"skatemount/{stage}-v{VERSION}"
        if name not in gymnasium.registry:
            gymnasium.register(
                name,
                entry_point=f"{__name__}:GymnasiumEnv",
                vector_entry_point=f"{__name__}:GymnasiumVectorEnv",
                kwargs={"stage": stage},
            )


register_stages()
