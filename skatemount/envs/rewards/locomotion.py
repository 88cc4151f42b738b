"""Rewards of walking and of moving well: the base terms of the paper's code (Isaac-style defaults) and ours.

Every function returns ``[N]``, unweighed. "Paper's code" means the settings of its published runs.
"""

from __future__ import annotations

import torch
from torch import Tensor

from skatemount.envs import success
from skatemount.envs.geometry import rotate_inverse
from skatemount.envs.rewards.table import event_penalty, penalty, reward
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.terms import TaskContext


@event_penalty
def termination(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """1 in the step in which a termination ends the episode (an event; the paper's code: 200 x 0.02 s = 4)."""
    return episode.terminated.to(sim.base_pos.dtype)


@reward
def alive(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """1 in every step."""
    return torch.ones_like(sim.ground_height)


@penalty
def lin_vel_z(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """v_z^2 of the trunk in its own frame, m^2/s^2 (paper's code)."""
    return sim.base_lin_vel[:, 2].square()


@penalty
def ang_vel_xy(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """w_x^2 + w_y^2 of the trunk, rad^2/s^2 (paper's code)."""
    return sim.base_ang_vel[:, :2].square().sum(-1)


@penalty
def flat_orientation(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """g_x^2 + g_y^2 of gravity's direction in the trunk frame (Isaac-style default)."""
    return sim.gravity[:, :2].square().sum(-1)


@reward
def upward(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """(1 - g_z)^2, 4 when upright (paper's code)."""
    return (1 - sim.gravity[:, 2]).square()


@penalty
def base_height(sim: SimState, episode: EpisodeState, context: TaskContext, target: float | None = None) -> Tensor:
    """(h - h*)^2 with h the height of the trunk above its soles, m^2.

    Ours: the paper's code measures from the world's floor, so that its robot is told to crouch by the deck's height.

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        target: h*, m; the default stance's height if null.
    """
    goal = context.stance_height if target is None else target
    soles = sim.foot_pos[..., 2].mean(-1) - context.foot_radius
    return (sim.base_pos[:, 2] - soles - goal).square()


@penalty
def base_height_world(sim: SimState, episode: EpisodeState, context: TaskContext, target: float = 0.35) -> Tensor:
    """(z - z*)^2 with z the height of the trunk above the world's floor, m^2 (paper's code, on the board too)."""
    return (sim.base_pos[:, 2] - target).square()


@penalty
def joint_torques(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Sum of squared joint torques, (N m)^2 (paper's code)."""
    return sim.joint_torque.square().sum(-1)


@penalty
def joint_acc(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Sum of squared joint accelerations, rad^2/s^4 (paper's code)."""
    return sim.joint_acc.square().sum(-1)


@penalty
def joint_vel(sim: SimState, episode: EpisodeState, context: TaskContext, when_mounted: bool = False) -> Tensor:
    """Sum of squared joint velocities, rad^2/s^2 (ours).

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        when_mounted: Count it only while the robot stands on the board.
    """
    value = sim.joint_vel.square().sum(-1)
    return value * episode.mounted if when_mounted else value


@penalty
def joint_limits(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Sum of how far joints are outside the middle 90 % of their ranges, rad (paper's code)."""
    low, high = context.soft_limits.unbind(-1)
    return ((low - sim.joint_pos).clamp(min=0) + (sim.joint_pos - high).clamp(min=0)).sum(-1)


@penalty
def joint_power(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Sum of |velocity x torque|, W (paper's code)."""
    return (sim.joint_vel * sim.joint_torque).abs().sum(-1)


@penalty
def joint_pose(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """||q - q_default||, rad (paper's code)."""
    return torch.linalg.vector_norm(sim.joint_pos - context.default_pose, dim=-1)


@penalty
def joint_pose_squared(sim: SimState, episode: EpisodeState, context: TaskContext, when_mounted: float = 0.0) -> Tensor:
    """||q - q_default||^2, rad^2 (ours).

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        when_mounted: How many times more it counts while the robot stands on the board.
    """
    value = (sim.joint_pos - context.default_pose).square().sum(-1)
    return value * (1 + when_mounted * episode.mounted)


@penalty
def joint_mirror(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Half the squared differences of diagonal legs, FR - RL and FL - RR, raw angles, rad^2 (paper's code)."""
    fr, fl, rr, rl = sim.joint_pos.unflatten(-1, (4, 3)).unbind(1)
    return 0.5 * ((fr - rl).square().sum(-1) + (fl - rr).square().sum(-1))


@penalty
def action_rate(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """||a_t - a_(t-1)||^2 of the clipped actions (paper's code)."""
    return (episode.action - episode.previous_action).square().sum(-1)


@penalty
def undesired_contacts(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """How many robot parts other than feet touch anything with more than 1 N (paper's code)."""
    return success.body_contacts(sim).sum(-1).to(sim.base_pos.dtype)


@penalty
def contact_forces(sim: SimState, episode: EpisodeState, context: TaskContext, threshold: float = 100.0) -> Tensor:
    """Sum over feet of the contact force beyond a threshold, N (paper's code)."""
    force = torch.linalg.vector_norm(sim.foot_deck_force + sim.foot_other_force, dim=-1)
    return (force - threshold).clamp(min=0).sum(-1)


@reward
def track_lin_vel(sim: SimState, episode: EpisodeState, context: TaskContext, sigma: float = 0.5) -> Tensor:
    """exp(-||v_xy* - v_xy||^2 / sigma^2), trunk frame (paper's code, sigma 0.5 m/s)."""
    error = (episode.command[:, :2] - sim.base_lin_vel[:, :2]).square().sum(-1)
    return torch.exp(-error / sigma**2)


@reward
def track_ang_vel(sim: SimState, episode: EpisodeState, context: TaskContext, sigma: float = 0.5) -> Tensor:
    """exp(-(w_z* - w_z)^2 / sigma^2) (paper's code, sigma 0.5 rad/s)."""
    return torch.exp(-(episode.command[:, 2] - sim.base_ang_vel[:, 2]).square() / sigma**2)


def _commanded(episode: EpisodeState) -> Tensor:
    return torch.linalg.vector_norm(episode.command, dim=-1) > 0.1


@reward
def touchdown_without_command(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """How many feet begin a contact in this step while the command is below 0.1 (paper's code)."""
    return episode.touchdown.sum(-1) * ~_commanded(episode)


@penalty
def feet_stumble(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """1 if any foot's horizontal contact force exceeds four times its vertical one (paper's code)."""
    force = sim.foot_deck_force + sim.foot_other_force
    sideways = torch.linalg.vector_norm(force[..., :2], dim=-1)
    return (sideways > 4 * force[..., 2].abs()).any(-1).to(sim.base_pos.dtype)


@penalty
def feet_slide(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Sum over touching feet of the horizontal speed relative to what they stand on, m/s.

    Ours: the paper's code measures relative to the trunk, which punishes walking; see `feet_slide_base`.
    """
    on_deck = torch.linalg.vector_norm(sim.foot_vel_board[..., :2], dim=-1)
    on_ground = torch.linalg.vector_norm(sim.foot_vel[..., :2], dim=-1)
    return (torch.where(episode.on_deck, on_deck, on_ground) * episode.touching).sum(-1)


@penalty
def feet_slide_base(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Sum over touching feet of the horizontal speed relative to the trunk, trunk frame, m/s (paper's code)."""
    relative = _foot_velocity_base(sim)
    return (torch.linalg.vector_norm(relative[..., :2], dim=-1) * episode.touching).sum(-1)


@penalty
def feet_height_body(sim: SimState, episode: EpisodeState, context: TaskContext, target: float = -0.2) -> Tensor:
    """Sum over feet of (z - z*)^2 tanh(2 ||v_xy||) in the trunk frame while commanded to move (paper's code), m^2."""
    speed = torch.linalg.vector_norm(_foot_velocity_base(sim)[..., :2], dim=-1)
    lift = (sim.foot_pos_base[..., 2] - target).square() * torch.tanh(2 * speed)
    return lift.sum(-1) * _commanded(episode)


def _foot_velocity_base(sim: SimState) -> Tensor:
    """Velocity of the feet relative to the trunk's centre in the trunk frame, ``[N, 4, 3]`` m/s."""
    return rotate_inverse(sim.base_rot, sim.foot_vel) - sim.base_lin_vel.unsqueeze(1)
