"""What may be seen: every observation term, a function of state, episode and constants that returns ``[N, size]``."""

from __future__ import annotations

import functools

import torch
from torch import Tensor

from skatemount.envs import success
from skatemount.envs.geometry import rotate_inverse
from skatemount.envs.observations.table import observation
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.terms import TaskContext
from skatemount.utils.errors import ConfigError


@observation(3, "axial")
def base_ang_vel(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Angular velocity of the trunk, trunk frame, ``[N, 3]`` rad/s."""
    return sim.base_ang_vel


@observation(3, "vector")
def base_lin_vel(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Linear velocity of the trunk, trunk frame, ``[N, 3]`` m/s."""
    return sim.base_lin_vel


@observation(3, "vector")
def gravity(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Direction of gravity in the trunk frame, ``[N, 3]``; upright is (0, 0, -1)."""
    return sim.gravity


@observation(3, "command")
def command(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Velocity command: forward and left, m/s, turn left, rad/s, ``[N, 3]``."""
    return episode.command


@observation(12, "joints")
def joint_pos(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Joint angles from the default pose, ``[N, 12]`` rad."""
    return sim.joint_pos - context.default_pose


@observation(12, "joints")
def joint_vel(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Joint velocities, ``[N, 12]`` rad/s."""
    return sim.joint_vel


@observation(12, "joints")
def last_action(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """The action of the last step, clipped, ``[N, 12]``."""
    return episode.action


@observation(3, "vector")
def board_pos(sim: SimState, episode: EpisodeState, context: TaskContext, at: str = "deck") -> Tensor:
    """Place of the board in the trunk frame, ``[N, 3]`` m.

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        at: ``deck``, the centre of the deck's top, or ``ground``, the point of the board's frame a deck's height
            below it (the paper's code).
    """
    if at == "deck":
        return sim.board_pos_base
    if at != "ground":
        raise ConfigError(f"observation.board_pos.params.at={at} must be deck or ground")
    return sim.board_pos_base - context.deck_height * sim.board_rot_base[..., 2]


@observation(6, "vector")
def board_axes(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """The board's x and z axes in the trunk frame, ``[N, 6]``; x points to the end that the trunk faces."""
    return torch.cat((sim.board_rot_base[..., 0] * episode.board_direction, sim.board_rot_base[..., 2]), -1)


@observation(1, None)
def board_yaw(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Yaw of the board in the trunk frame within [0, 2 pi), ``[N, 1]`` rad, as in the paper's code (it jumps at 0)."""
    x_axis = sim.board_rot_base[..., 0]
    return torch.atan2(x_axis[:, 1], x_axis[:, 0]).remainder(2 * torch.pi).unsqueeze(-1)


def outline_points(deck_half: tuple[float, float], points: int) -> Tensor:
    """Points at equal arc length around the deck's top edge, from the middle of the front, leftwards.

    Args:
        deck_half: Half length and half width of the deck, m.
        points: How many.

    Returns:
        ``[points, 3]`` in the board frame, m.
    """
    half_x, half_y = deck_half
    corners = [(half_x, 0.0), (half_x, half_y), (-half_x, half_y), (-half_x, -half_y), (half_x, -half_y)]
    path = torch.tensor([*corners, corners[0]])
    length = torch.linalg.vector_norm(path.diff(dim=0), dim=1)
    reached = torch.cat((torch.zeros(1), length.cumsum(0)))
    s = torch.arange(points) / points * reached[-1]
    leg = torch.searchsorted(reached, s, right=True).clamp(1, len(length)) - 1
    part = ((s - reached[leg]) / length[leg]).unsqueeze(1)
    flat = path[leg] + part * (path[leg + 1] - path[leg])
    return torch.cat((flat, torch.zeros(points, 1)), 1)


def _carrier(points: Tensor, device: torch.device) -> Tensor:
    """What takes a board's axes, ``[9]``, to where its points are from its centre: ``[P, 3]`` m to ``[9, 3 P]``.

    One product of two matrices is faster than a small product in every world.
    """
    # Kept for all to come, also for who differentiates.
    with torch.inference_mode(False):
        return torch.einsum("ik,pj->ijpk", torch.eye(3), points.clone()).reshape(9, -1).to(device)


def _carry(sim: SimState, axes: Tensor, carrier: Tensor) -> Tensor:
    """Points of the board in the trunk frame, ``[N, 3 P]`` m, for the board's axes in that frame, ``[N, 3, 3]``."""
    # The place is added, not multiplied: training may round products more coarsely than float32.
    return ((axes.flatten(1) @ carrier).view(len(axes), -1, 3) + sim.board_pos_base.unsqueeze(1)).flatten(1)


@observation(lambda params: 3 * params.get("points", 16), "outline")
def outline(sim: SimState, episode: EpisodeState, context: TaskContext, points: int = 16) -> Tensor:
    """Points at equal arc length around the deck's top edge, trunk frame, ``[N, 3 points]`` m.

    They begin in the middle of the end that the trunk faces.
    """
    return _carry(sim, sim.board_rot_base * _turn(episode), _outline(context.deck_half, points, sim.base_pos.device))


@functools.lru_cache(64)
def _outline(deck_half: tuple[float, float], points: int, device: torch.device) -> Tensor:
    return _carrier(outline_points(deck_half, points), device)


@observation(72, None)
def outline_paper(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """The paper's 24 edge points in the trunk frame, ``[N, 72]`` m.

    A walk around the deck in steps of 0.083 m, 12 mm above its top, that overshoots the corners as the paper's code
    does (its points on the short edges end 82 mm outside).
    """
    return _carry(sim, sim.board_rot_base, _paper_outline(context.deck_half, sim.base_pos.device))


@functools.lru_cache(64)
def _paper_outline(deck_half: tuple[float, float], device: torch.device) -> Tensor:
    half_x, half_y = deck_half
    step = 0.083
    long_edge = [-half_x + step * i for i in range(8)]
    short_edge = [-half_y + step * (i + 1) for i in range(4)]
    points = [(x, -half_y) for x in long_edge] + [(half_x, y) for y in short_edge]
    points += [(-x, half_y) for x in long_edge] + [(-half_x, -y) for y in short_edge]
    return _carrier(torch.tensor([(x, y, 0.012) for x, y in points]), device)


@observation(12, "feet")
def feet_base(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Feet's centres in the trunk frame, ``[N, 12]`` m."""
    return sim.foot_pos_base.flatten(1)


@observation(12, None)
def feet_base_left_first(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Feet's centres in the trunk frame in the order FL, FR, RL, RR of the paper's simulator, ``[N, 12]`` m."""
    return sim.foot_pos_base[:, [1, 0, 3, 2]].flatten(1)


@observation(12, "feet")
def feet_board(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Feet's centres in the board frame, its x axis toward the end that the trunk faces, ``[N, 12]`` m."""
    return (sim.foot_pos_board * _turn(episode)).flatten(1)


def _turn(episode: EpisodeState) -> Tensor:
    """Factor of the board's axes that turns x to the end that the trunk faces, ``[N, 1, 3]``."""
    return torch.nn.functional.pad(episode.board_direction.expand(-1, 2), (0, 1), value=1.0).unsqueeze(1)


@observation(4, "flags")
def on_deck(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Feet that press on the deck from above, ``[N, 4]`` of 0 and 1."""
    return episode.on_deck.to(sim.base_pos.dtype)


@observation(4, "flags")
def off_time(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Seconds since each foot last pressed on the deck, at most 1, ``[N, 4]``."""
    return episode.off_time.clamp(max=1.0)


@observation(4, "flags")
def deck_touch(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Feet with any force at all against the deck, ``[N, 4]`` of 0 and 1 (the paper's flag: no threshold)."""
    return (sim.foot_deck_force != 0).any(-1).to(sim.base_pos.dtype)


@observation(8, "flags_twice")
def foot_forces(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Contact force of each foot with the deck and with anything else, ``[N, 8]`` in units of 100 N."""
    forces = torch.cat((sim.foot_deck_force, sim.foot_other_force), 1)
    return torch.linalg.vector_norm(forces, dim=-1) * 0.01


@observation(13, "bodies")
def body_contacts(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Robot parts other than feet that touch something, ``[N, 13]`` of 0 and 1."""
    return success.body_contacts(sim).to(sim.base_pos.dtype)


@observation(6, "vector_axial")
def board_velocity(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Linear and angular velocity of the board in the trunk frame, ``[N, 6]`` m/s and rad/s."""
    both = torch.stack((sim.board_lin_vel, sim.board_ang_vel), 1)
    return rotate_inverse(sim.base_rot, both).flatten(1)


@observation(2, "negative")
def truck_angle(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """The truck at the end that the trunk faces and the other one, about their axes, ``[N, 2]`` rad."""
    return torch.where(episode.board_direction > 0, sim.truck_angle, sim.truck_angle.flip(-1))


@observation(3, "scalars")
def heights(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Trunk above the robot's floor, deck above the robot's floor (m), board welded (0 or 1), ``[N, 3]``."""
    fixed = sim.board_fixed.to(sim.base_pos.dtype)
    base, deck = sim.base_pos[:, 2] - sim.ground_height, sim.board_pos[:, 2] - sim.ground_height
    return torch.stack((base, deck, fixed), 1)


@observation(1, "scalars")
def mounted_time(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Seconds that the robot has stood on the board without a break, at most 1, ``[N, 1]``."""
    return episode.mounted_time.clamp(max=success.HOLD).unsqueeze(-1)
