"""The Markov decision process of the task: targets, observations, rewards, terminations and success.

`Mdp` works on a batch of any size and uses no engine. `skatemount.envs.mount_env.MountEnv` gives it a batch of worlds,
and `skatemount.envs.task.MountTask` a batch of one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from skatemount.envs import riding, success
from skatemount.envs.commands import CommandGenerator
from skatemount.envs.config.task import TaskConfig
from skatemount.envs.geometry import board_direction
from skatemount.envs.legs import Legs
from skatemount.envs.memory import TermMemory
from skatemount.envs.observations import ObservationTable
from skatemount.envs.rewards import RewardTable
from skatemount.envs.scene import Scene
from skatemount.envs.sensing import Sensing
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.tasks import TASKS
from skatemount.envs.tasks.trial import try_task
from skatemount.envs.terminations import TerminationTable
from skatemount.envs.terms import TaskContext


@dataclass
class StepResult:
    """The result of a control step.

    Attributes:
        reward: ``[N]``, the sum of the reward terms.
        reward_terms: ``[terms, N]``, the weighted reward terms.
        termination_flags: ``[terminations, N]`` bool; `Mdp.termination_names` names the rows.
        terminated: ``[N]`` bool, a termination ended the episode.
        truncated: ``[N]`` bool, no termination, but the time limit or `Mdp.max_mounted_time` ended the episode.
        succeeded: ``[N]`` bool, the episode was truncated and meets the task's success criterion.
    """

    reward: Tensor
    reward_terms: Tensor
    termination_flags: Tensor
    terminated: Tensor
    truncated: Tensor
    succeeded: Tensor


class Mdp:
    """Observations, rewards and terminations of a task, and the updates of the episodes that they need.

    Args:
        config: Settings of the task.
        scene: The scene, for its constants.
        generator: Source of commands, sensor errors and observation noise.

    Attributes:
        context: Constants of the task.
        device: Device of the states, that of the generator.
        definition: The task's success criterion and metrics.
        sensing: The robot's sensors; the policy's observation and the command come from what they show.
        observation: Observation of the policy.
        privileged: Observation that only the critic gets, in addition to the policy's.
        rewards: Reward terms.
        terminations: Termination terms.
        memory: Memory of those terms that have one.
        commands: Source of the velocity commands.
        sensed: ``[N]``, the states of the last step as the sensors showed them; None before the first step.
        max_mounted_time: Time that the robot has been mounted after which an episode is truncated, s; infinite if the
            time limit is the only one.

    Raises:
        ConfigError: A setting of a term cannot be used, or a function of the task fails.
    """

    def __init__(self, config: TaskConfig, scene: Scene, generator: torch.Generator):
        self.generator, self.device = generator, generator.device
        robot, tables = scene.robot, config.observation
        # Constants are created on the device of the states.
        with self.device:
            self.context = TaskContext.of(scene, config.episode_length)
            self.observation = ObservationTable(
                tables.policy, self.context, "observation.policy", tables.history_length
            )
            self.privileged = ObservationTable(tables.privileged, self.context, "observation.privileged")
            self.rewards = RewardTable(config.reward, self.context)
            self.terminations = TerminationTable(config.termination, self.context)
            self._scale = torch.as_tensor(robot.action_scale, dtype=torch.float32)
            legs = Legs(robot.spec)
        step, timestep = scene.solver.control_step, scene.solver.timestep
        self.sensing = Sensing(config.sensing, legs, step, timestep, generator)
        observing = [*self.observation.memory, *self.privileged.memory]
        self.memory = TermMemory(
            [*self.rewards.memory, *self.terminations.memory, *observing], observing, self.context, self.device
        )
        self.commands = CommandGenerator(
            config.command, self.context.control_step, generator, scene.deck_height, scene.board.config.max_curvature
        )
        self.sensed: SimState | None = None
        # The time constant of `EpisodeState.soft_success` is 0.35 s.
        self._soft_success_decay = math.exp(-self.context.control_step / 0.35)
        self.definition = TASKS.get(config.success)
        try_task(self.definition, self.context, self.no_episodes)
        self.max_mounted_time = math.inf
        self._noise = generator if tables.noise and config.sensing.term_noise else None
        self._action_clip = robot.config.action_clip

    def no_episodes(self, num_worlds: int) -> EpisodeState:
        """Create episodes without any history, ``[num_worlds]``."""
        size, rides = self.observation.size, self.commands.rides
        return EpisodeState.zeros(num_worlds, self.context.layout, size, self.device, rides)

    def targets(self, action: Tensor) -> Tensor:
        """Convert actions to joint position targets.

        Args:
            action: ``[N, J]``.

        Returns:
            ``[N, J]`` rad: default pose + scale x clipped action, less the offsets of the encoders.
        """
        targets = self.context.default_pose + self._scale * action.clamp(-self._action_clip, self._action_clip)
        return self.sensing.targets(targets)

    def allocate(self, num_worlds: int) -> None:
        """Make the memory of terms and sensors for a number of worlds whose episodes begin."""
        self.memory.allocate(num_worlds)
        self.sensing.allocate(num_worlds)

    def begin(
        self,
        sim: SimState,
        bins: Tensor | None = None,
        rows: Tensor | None = None,
        dynamics: Tensor | None = None,
    ) -> EpisodeState:
        """Begin new episodes.

        Args:
            sim: ``[N]`` start states.
            bins: ``[N]`` int64, the curriculum bins of the start states; -1 for none. All -1 if None.
            rows: ``[N]`` int64, the worlds of the states in `memory`. None if there are no other worlds.
            dynamics: ``[N, 8]`` physics of the worlds, see `EpisodeState`; all 0 if None.

        Returns:
            ``[N]`` episodes at their start.
        """
        fresh = self.no_episodes(sim.base_pos.shape[0])
        if bins is not None:
            fresh.bin = bins
        if dynamics is not None:
            fresh.dynamics = dynamics
        distance = torch.linalg.vector_norm(sim.board_pos[:, :2] - sim.base_pos[:, :2], dim=-1)
        on_deck = success.feet_on_deck(sim)
        fresh.on_deck = on_deck
        fresh.off_time = torch.where(on_deck, 0.0, torch.inf)
        sensed = self.sensing.begin(sim, fresh, rows)
        fresh.board_direction = board_direction(sensed.board_rot_base)
        off_deck = success.feet_off_deck_contact(sim)
        fresh.touching, fresh.foot_off_deck_contact = on_deck | off_deck, off_deck.any(1)
        fresh.distance, fresh.previous_distance = distance, distance.clone()
        fresh.first_contact = torch.where(on_deck.any(1), 0.0, torch.inf)
        to_board = sim.board_rot.transpose(-1, -2)
        position = (to_board @ (sim.base_pos - sim.board_pos).unsqueeze(-1)).squeeze(-1)
        heading = (to_board @ sim.base_rot[..., :1]).squeeze(-1)
        fresh.start = torch.cat((position[:, :2], torch.atan2(heading[:, 1:2], heading[:, :1])), 1)
        self.commands.update(sensed, fresh)
        self.memory.begin(sim, fresh, rows)
        fresh.observation = self.observation(sensed, self.sensing.contacts(fresh, rows), self._noise)
        return fresh

    def advance(self, sim: SimState, episode: EpisodeState, action: Tensor, diverged: Tensor) -> StepResult:
        """Update the episodes by a control step, in place.

        Args:
            sim: The state after the step.
            episode: The episodes before the step; updated in place.
            action: ``[N, J]``, the actions of the step.
            diverged: ``[N]`` bool, worlds whose physics failed.

        Returns:
            Rewards, and the episodes that ended.
        """
        step = self.context.control_step
        self.memory.next_step()
        episode.step = episode.step + 1
        episode.previous_action = episode.action
        episode.action = action.clamp(-self._action_clip, self._action_clip)
        episode.previous_distance = episode.distance
        episode.distance = torch.linalg.vector_norm(sim.board_pos[:, :2] - sim.base_pos[:, :2], dim=-1)
        on_deck = success.feet_on_deck(sim)
        off_deck = success.feet_off_deck_contact(sim)
        touching = on_deck | off_deck
        episode.foot_off_deck_contact = off_deck.any(1)
        episode.touchdown = touching & ~episode.touching
        episode.touching = touching
        episode.on_deck = on_deck
        episode.off_time = torch.where(on_deck, 0.0, episode.off_time + step)
        sensed = self.sensed = self.sensing.sense(sim, episode)
        episode.board_direction = board_direction(sensed.board_rot_base, episode.board_direction)
        velocity = torch.linalg.vector_norm(sim.base_lin_vel[:, :2] - episode.command[:, :2], dim=-1)
        turn = (sim.base_ang_vel[:, 2] - episode.command[:, 2]).abs()
        episode.command_error = episode.command_error + torch.stack((velocity, turn), 1)
        episode.mounted = success.is_mounted(sim, episode.off_time, episode.foot_off_deck_contact)
        near = success.nearly_mounted(
            sim, episode.foot_off_deck_contact, self.context.deck_half_of(sim), self.context.foot_radius
        )
        episode.soft_success = torch.lerp(near, episode.soft_success, self._soft_success_decay)
        episode.mounted_time = torch.where(episode.mounted, episode.mounted_time + step, 0.0)
        elapsed = torch.where(on_deck.any(1), episode.step * step, math.inf)
        episode.first_contact = torch.minimum(episode.first_contact, elapsed)
        riding.advance(sim, episode, self.context)

        termination_flags = torch.cat((self.terminations(sim, episode), diverged.unsqueeze(0)))
        terminated = termination_flags.any(0)
        episode.terminated = terminated
        over = (episode.step >= self.context.episode_steps) | (episode.mounted_time >= self.max_mounted_time - step / 2)
        truncated = over & ~terminated
        reward_terms = self.rewards(sim, episode)
        # The values of a diverged world mean nothing, and one that is not finite would spoil the whole batch.
        reward_terms = torch.where(diverged, 0.0, reward_terms)
        self.commands.update(sensed, episode)
        seen = self.sensing.contacts(episode)
        episode.observation = self.observation(sensed, seen, self._noise, episode.observation)
        if self.privileged.memory:
            # Once in each step, whether or not it is asked for.
            self.privileged(sim, episode)
        succeeded = truncated & self.definition.succeeded(sim, episode, self.context)
        return StepResult(reward_terms.sum(0), reward_terms, termination_flags, terminated, truncated, succeeded)

    def termination_names(self) -> list[str]:
        """Return the names of the rows of `StepResult.termination_flags`."""
        return [*self.terminations.names, "diverged"]

    def observe(self, sim: SimState, episode: EpisodeState) -> tuple[Tensor, Tensor]:
        """Return the present observations.

        Args:
            sim: The state.
            episode: The episodes.

        Returns:
            The policy's, ``[N, observation.size]``, with noise if it is on, and the critic's, ``[N, privileged.size]``.
        """
        return episode.observation, self.privileged(sim, episode)
