"""The task's mathematics, once: what an action does to an episode, and what is seen, earned and ended.

`Mdp` is used on a batch by `skatemount.envs.mount_env.MountEnv` and on a batch of one by
`skatemount.envs.task.MountTask`; it touches no engine.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from skatemount.envs import success
from skatemount.envs.commands import CommandGenerator
from skatemount.envs.config.task import TaskConfig
from skatemount.envs.geometry import board_direction
from skatemount.envs.observations import ObservationTable
from skatemount.envs.rewards import RewardTable
from skatemount.envs.scene import Scene
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.terminations import TerminationTable
from skatemount.envs.terms import TaskContext


@dataclass
class StepResult:
    """What a control step led to.

    Attributes:
        reward: ``[N]``.
        reward_terms: ``[terms, N]``, every reward term's weighed share.
        termination_flags: ``[terminations, N]`` bool.
        terminated: ``[N]`` bool, ended by a termination.
        truncated: ``[N]`` bool, ended by the time limit alone, or by having stood long max_mounted_time.
        succeeded: ``[N]`` bool, truncated, and achieved what the task asks for.
    """

    reward: Tensor
    reward_terms: Tensor
    termination_flags: Tensor
    terminated: Tensor
    truncated: Tensor
    succeeded: Tensor


class Mdp:
    """Observations, rewards, terminations and the history they need.

    Args:
        config: Settings of the task.
        scene: The scene, for its constants.
        generator: Source of commands and observation noise.

    Attributes:
        context: Constants.
        device: Where states are expected: that of the generator.
        criterion: What an episode must achieve, a name of `skatemount.envs.success.ACHIEVED`.
        observation: What the policy sees.
        privileged: What only the critic sees besides.
        rewards: Reward terms.
        terminations: Termination terms.
        max_mounted_time: Seconds of standing on the board after which an episode ends as at its time limit.
    """

    def __init__(self, config: TaskConfig, scene: Scene, generator: torch.Generator):
        self.generator, self.device = generator, generator.device
        robot, seen = scene.robot, config.observation
        # What is made of numbers is made where it is going to be used.
        with self.device:
            self.context = TaskContext.of(scene, config.episode_length)
            self.observation = ObservationTable(seen.policy, self.context, "observation.policy", seen.history_length)
            self.privileged = ObservationTable(seen.privileged, self.context, "observation.privileged")
            self.rewards = RewardTable(config.reward, self.context)
            self.terminations = TerminationTable(config.termination, self.context)
            self._scale = torch.as_tensor(robot.action_scale, dtype=torch.float32)
        self._command_generator = CommandGenerator(config.command, self.context.control_step, generator)
        self._fade = math.exp(-self.context.control_step / 0.35)
        self.criterion = config.success
        self.max_mounted_time = math.inf
        self._succeeded = success.ACHIEVED[config.success]
        self._noise = generator if seen.noise else None
        self._clip = robot.config.action_clip

    def targets(self, action: Tensor) -> Tensor:
        """Joint position targets of actions.

        Args:
            action: ``[N, 12]``.

        Returns:
            ``[N, 12]`` rad: default pose + scale x clipped action.
        """
        return self.context.default_pose + self._scale * action.clamp(-self._clip, self._clip)

    def begin(self, sim: SimState, bins: Tensor | None = None) -> EpisodeState:
        """New episodes.

        Args:
            sim: The start states, ``[N]``.
            bins: ``[N]`` int64, the parts of a curriculum that they come from.

        Returns:
            ``[N]`` episodes at their start.
        """
        fresh = EpisodeState.zeros(sim.base_pos.shape[0], self.observation.size, self.device)
        if bins is not None:
            fresh.bin = bins
        distance = torch.linalg.vector_norm(sim.board_pos[:, :2] - sim.base_pos[:, :2], dim=-1)
        on_deck = success.feet_on_deck(sim)
        fresh.on_deck = on_deck
        fresh.board_direction = board_direction(sim.board_rot_base)
        fresh.off_time = torch.where(on_deck, 0.0, torch.inf)
        elsewhere = success.feet_elsewhere(sim)
        fresh.touching, fresh.foot_off_deck_contact = on_deck | elsewhere, elsewhere.any(1)
        fresh.distance, fresh.previous_distance = distance, distance.clone()
        fresh.first_contact = torch.where(on_deck.any(1), 0.0, torch.inf)
        relative = sim.board_rot.transpose(-1, -2)
        place = (relative @ (sim.base_pos - sim.board_pos).unsqueeze(-1)).squeeze(-1)
        heading = (relative @ sim.base_rot[..., :1]).squeeze(-1)
        fresh.start = torch.cat((place[:, :2], torch.atan2(heading[:, 1:2], heading[:, :1])), 1)
        self._command_generator.update(sim, fresh)
        fresh.seen = self.observation(sim, fresh, self._noise)
        return fresh

    def advance(self, sim: SimState, episode: EpisodeState, action: Tensor, diverged: Tensor) -> StepResult:
        """Account for a control step, in place.

        Args:
            sim: The state after the step.
            episode: The episodes before it; brought up to date.
            action: ``[N, 12]``, the step's actions.
            diverged: ``[N]`` bool, worlds whose physics failed.

        Returns:
            What the step led to.
        """
        step = self.context.control_step
        episode.step = episode.step + 1
        episode.previous_action = episode.action
        episode.action = action.clamp(-self._clip, self._clip)
        episode.previous_distance = episode.distance
        episode.distance = torch.linalg.vector_norm(sim.board_pos[:, :2] - sim.base_pos[:, :2], dim=-1)
        on_deck = success.feet_on_deck(sim)
        elsewhere = success.feet_elsewhere(sim)
        touching = on_deck | elsewhere
        episode.foot_off_deck_contact = elsewhere.any(1)
        episode.touchdown = touching & ~episode.touching
        episode.touching = touching
        episode.on_deck = on_deck
        episode.board_direction = board_direction(sim.board_rot_base, episode.board_direction)
        episode.off_time = torch.where(on_deck, 0.0, episode.off_time + step)
        velocity = torch.linalg.vector_norm(sim.base_lin_vel[:, :2] - episode.command[:, :2], dim=-1)
        turn = (sim.base_ang_vel[:, 2] - episode.command[:, 2]).abs()
        episode.command_error = episode.command_error + torch.stack((velocity, turn), 1)
        episode.mounted = success.is_mounted(sim, episode.off_time, episode.foot_off_deck_contact)
        near = success.nearly_mounted(
            sim, episode.foot_off_deck_contact, self.context.deck_half, self.context.foot_radius
        )
        episode.soft_success = torch.lerp(near, episode.soft_success, self._fade)
        episode.mounted_time = torch.where(episode.mounted, episode.mounted_time + step, 0.0)
        elapsed = torch.where(on_deck.any(1), episode.step * step, math.inf)
        episode.first_contact = torch.minimum(episode.first_contact, elapsed)

        termination_flags = torch.cat((self.terminations(sim, episode), diverged.unsqueeze(0)))
        terminated = termination_flags.any(0)
        episode.terminated = terminated
        over = (episode.step >= self.context.episode_steps) | (episode.mounted_time >= self.max_mounted_time - step / 2)
        truncated = over & ~terminated
        reward_terms = self.rewards(sim, episode)
        # What a failed world shows means nothing; one number that is not finite would spoil the whole batch.
        reward_terms = torch.where(diverged, 0.0, reward_terms)
        self._command_generator.update(sim, episode)
        episode.seen = self.observation(sim, episode, self._noise, episode.seen)
        succeeded = truncated & self._succeeded(episode, step)
        return StepResult(reward_terms.sum(0), reward_terms, termination_flags, terminated, truncated, succeeded)

    def end_names(self) -> list[str]:
        """Names of the rows of `StepResult.termination_flags`."""
        return [*self.terminations.names, "diverged"]

    def observe(self, sim: SimState, episode: EpisodeState) -> tuple[Tensor, Tensor]:
        """What policy and critic see.

        Args:
            sim: The state.
            episode: The episodes.

        Returns:
            ``[N, observation.size]``, with noise if it is on, and ``[N, privileged.size]``.
        """
        return episode.seen, self.privileged(sim, episode)
