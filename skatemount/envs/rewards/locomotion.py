"""Rewards for walking and smooth motion: the base terms of the paper's code (Isaac-style defaults) and our own.

Every function returns ``[N]``, without its weight. "Paper's code" means the settings of the paper's published runs,
"ours" a term that is not in them.
"""

from __future__ import annotations

import torch
from torch import Tensor

from skatemount.envs import success
from skatemount.envs.geometry import rotate_inverse
from skatemount.envs.memory import TermWithMemory
from skatemount.envs.rewards.table import event_penalty, penalty, reward
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.terms import TaskContext


@event_penalty
def termination(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Penalize a termination: 1 in the step in which one ends the episode, else 0 (paper's code).

    The weight counts for each occurrence. The paper's code has 200 per second at 50 Hz, which is 4 for each.
    """
    return episode.terminated.to(sim.base_pos.dtype)


@reward
def alive(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return 1 in every step (ours)."""
    return torch.ones_like(sim.ground_height)


@penalty
def lin_vel_z(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Penalize the trunk's velocity along its z axis: v_z^2, m^2/s^2 (paper's code)."""
    return sim.base_lin_vel[:, 2].square()


@penalty
def ang_vel_xy(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Penalize roll and pitch rates of the trunk: w_x^2 + w_y^2, rad^2/s^2 (paper's code)."""
    return sim.base_ang_vel[:, :2].square().sum(-1)


@penalty
def flat_orientation(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Penalize a tilted trunk: g_x^2 + g_y^2, with g gravity's direction in the trunk frame (Isaac-style default)."""
    return sim.gravity[:, :2].square().sum(-1)


@reward
def upward(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Reward an upright trunk: (1 - g_z)^2, with g gravity's direction in the trunk frame; 4 upright (paper's code)."""
    return (1 - sim.gravity[:, 2]).square()


@penalty
def base_height(sim: SimState, episode: EpisodeState, context: TaskContext, target: float | None = None) -> Tensor:
    """Penalize deviation from the target height: (h - h*)^2, with h the trunk's height above its soles, m^2 (ours).

    The paper's code measures from the world's floor, which tells a mounted robot to crouch by the deck's height; see
    `base_height_world`.

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        target: Target height h*, m; the height of the default stance if null.
    """
    goal = context.stance_height if target is None else target
    soles = sim.foot_pos[..., 2].mean(-1) - context.foot_radius
    return (sim.base_pos[:, 2] - soles - goal).square()


@penalty
def base_height_world(sim: SimState, episode: EpisodeState, context: TaskContext, target: float = 0.35) -> Tensor:
    """Penalize deviation from the target height: (z - z*)^2, with z the trunk's world height, m^2 (paper's code).

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        target: Target height z* above the world's floor, m; the same on the board.
    """
    return (sim.base_pos[:, 2] - target).square()


@penalty
def joint_torques(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Penalize joint torques: the sum of their squares, (N m)^2 (paper's code)."""
    return sim.joint_torque.square().sum(-1)


@penalty
def joint_acc(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Penalize joint accelerations: the sum of their squares, rad^2/s^4 (paper's code)."""
    return sim.joint_acc.square().sum(-1)


@penalty
def joint_vel(sim: SimState, episode: EpisodeState, context: TaskContext, when_mounted: bool = False) -> Tensor:
    """Penalize joint velocities: the sum of their squares, rad^2/s^2 (ours).

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        when_mounted: True if the term counts only while the robot is mounted.
    """
    value = sim.joint_vel.square().sum(-1)
    return value * episode.mounted if when_mounted else value


@penalty
def joint_limits(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Penalize joints near their limits: the sum of angles beyond the middle 90 % of the range, rad (paper's code)."""
    low, high = context.soft_limits.unbind(-1)
    return ((low - sim.joint_pos).clamp(min=0) + (sim.joint_pos - high).clamp(min=0)).sum(-1)


@penalty
def joint_power(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Penalize mechanical power: the sum over joints of |velocity x torque|, W (paper's code)."""
    return (sim.joint_vel * sim.joint_torque).abs().sum(-1)


@penalty
def joint_pose(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Penalize deviation from the default pose: ||q - q_default||, rad (paper's code)."""
    return torch.linalg.vector_norm(sim.joint_pos - context.default_pose, dim=-1)


@penalty
def joint_pose_squared(sim: SimState, episode: EpisodeState, context: TaskContext, when_mounted: float = 0.0) -> Tensor:
    """Penalize deviation from the default pose: ||q - q_default||^2, rad^2 (ours).

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        when_mounted: Increase of the factor while the robot is mounted: the term is multiplied by 1 + when_mounted.
    """
    value = (sim.joint_pos - context.default_pose).square().sum(-1)
    return value * (1 + when_mounted * episode.mounted)


@penalty
def joint_mirror(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Penalize unequal diagonal legs: half the sum of squared joint differences, rad^2 (paper's code).

    The pairs are the robot's diagonals, FR - RL and FL - RR, with joint angles that are not mirrored.
    """
    legs = sim.joint_pos.unflatten(-1, context.layout.by_leg).unbind(1)
    first, second = ((legs[i] - legs[j]).square().sum(-1) for i, j in context.layout.diagonals)
    return 0.5 * (first + second)


@penalty
def action_rate(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Penalize changes of the clipped action: ||a_t - a_(t-1)||^2 (paper's code)."""
    return (episode.action - episode.previous_action).square().sum(-1)


@penalty
def undesired_contacts(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Count the robot bodies other than the feet that touch anything with more than 1 N (paper's code)."""
    return success.body_contacts(sim).sum(-1).to(sim.base_pos.dtype)


@penalty
def contact_forces(sim: SimState, episode: EpisodeState, context: TaskContext, threshold: float = 100.0) -> Tensor:
    """Penalize hard contacts: the sum over feet of the contact force beyond a threshold, N (paper's code).

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        threshold: Force that is not penalized, N.
    """
    force = torch.linalg.vector_norm(sim.foot_deck_force + sim.foot_other_force, dim=-1)
    return (force - threshold).clamp(min=0).sum(-1)


@reward
def track_lin_vel(sim: SimState, episode: EpisodeState, context: TaskContext, sigma: float = 0.5) -> Tensor:
    """Reward following the commanded velocity: exp(-||v_xy* - v_xy||^2 / sigma^2), trunk frame (paper's code).

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        sigma: Error at which the value falls to 1/e, m/s.
    """
    error = (episode.command[:, :2] - sim.base_lin_vel[:, :2]).square().sum(-1)
    return torch.exp(-error / sigma**2)


@reward
def track_ang_vel(sim: SimState, episode: EpisodeState, context: TaskContext, sigma: float = 0.5) -> Tensor:
    """Reward following the commanded turning rate: exp(-(w_z* - w_z)^2 / sigma^2), trunk frame (paper's code).

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        sigma: Error at which the value falls to 1/e, rad/s.
    """
    return torch.exp(-(episode.command[:, 2] - sim.base_ang_vel[:, 2]).square() / sigma**2)


def _commanded(episode: EpisodeState) -> Tensor:
    return torch.linalg.vector_norm(episode.command, dim=-1) > 0.1


@reward
def touchdown_without_command(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Count the feet that begin a contact in this step while the norm of the command is at most 0.1 (paper's code)."""
    return episode.touchdown.sum(-1) * ~_commanded(episode)


@reward
class FeetAirTime(TermWithMemory):
    """Reward long steps: the sum over feet of (air time - threshold) in the step of the first contact, s (legged_gym).

    A foot's air time is the time since its last contact. As in legged_gym, two steps count as one contact if either
    has one, and the term counts only while the norm of the commanded horizontal velocity is above 0.1 m/s (Rudin et
    al., "Learning to Walk in Minutes Using Massively Parallel Deep Reinforcement Learning", 2021, and the code with
    it). Here a contact is a force of more than 1 N on deck or ground in any direction.

    Args:
        context: Constants.
        num_worlds: Number of worlds.
        threshold: Air time that is worth nothing, s; shorter steps are penalized.
    """

    def __init__(self, context: TaskContext, num_worlds: int, threshold: float = 0.5):
        self._threshold = threshold
        self.air_time = torch.zeros(num_worlds, context.layout.num_feet)
        self.touched = torch.zeros(num_worlds, context.layout.num_feet, dtype=torch.bool)

    def reset(self, rows: Tensor) -> None:
        """Forget the air time of some worlds, ``[K]`` int64."""
        self.air_time.index_fill_(0, rows, 0.0)
        self.touched.index_fill_(0, rows, False)

    def __call__(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
        """Return the term, ``[N]`` s."""
        contact = episode.touching | self.touched
        landed = (self.air_time > 0) & contact
        air_time = self.air_time + context.control_step
        self.air_time, self.touched = torch.where(contact, 0.0, air_time), episode.touching
        walking = torch.linalg.vector_norm(episode.command[:, :2], dim=-1) > 0.1
        return ((air_time - self._threshold) * landed).sum(-1) * walking


@penalty
def feet_stumble(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Penalize stumbling: 1 if a foot's horizontal contact force exceeds four times its vertical one (paper's code)."""
    force = sim.foot_deck_force + sim.foot_other_force
    sideways = torch.linalg.vector_norm(force[..., :2], dim=-1)
    return (sideways > 4 * force[..., 2].abs()).any(-1).to(sim.base_pos.dtype)


@penalty
def feet_slide(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Penalize slipping: the sum over touching feet of the horizontal speed relative to deck or ground, m/s (ours).

    The paper's code measures relative to the trunk, which punishes walking; see `feet_slide_base`.
    """
    on_deck = torch.linalg.vector_norm(sim.foot_vel_board[..., :2], dim=-1)
    on_ground = torch.linalg.vector_norm(sim.foot_vel[..., :2], dim=-1)
    return (torch.where(episode.on_deck, on_deck, on_ground) * episode.touching).sum(-1)


@penalty
def feet_slide_base(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Penalize slipping: the sum over touching feet of the x-y speed in the trunk frame, m/s (paper's code)."""
    relative = _foot_velocity_base(sim)
    return (torch.linalg.vector_norm(relative[..., :2], dim=-1) * episode.touching).sum(-1)


@penalty
def feet_height_body(sim: SimState, episode: EpisodeState, context: TaskContext, target: float = -0.2) -> Tensor:
    """Penalize wrong foot heights: the sum over feet of (z - z*)^2 tanh(2 ||v_xy||), trunk frame, m^2 (paper's code).

    The term counts only while the norm of the command is above 0.1.

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        target: Target height z* of a moving foot in the trunk frame, m.
    """
    speed = torch.linalg.vector_norm(_foot_velocity_base(sim)[..., :2], dim=-1)
    lift = (sim.foot_pos_base[..., 2] - target).square() * torch.tanh(2 * speed)
    return lift.sum(-1) * _commanded(episode)


def _foot_velocity_base(sim: SimState) -> Tensor:
    """Compute the velocity of the feet relative to the trunk's center in the trunk frame, ``[N, F, 3]`` m/s."""
    return rotate_inverse(sim.base_rot, sim.foot_vel) - sim.base_lin_vel.unsqueeze(1)
