"""Observation terms: functions of state, episode and constants that return ``[N, size]``.

J, F and B are the numbers of the robot's joints, feet and bodies. "Paper's code" means the settings of the paper's
published runs.
"""

from __future__ import annotations

import functools
from typing import Any, Literal

import torch
from torch import Tensor

from skatemount.envs import success
from skatemount.envs.config.task import HOLD
from skatemount.envs.geometry import rotate_inverse
from skatemount.envs.observations.table import observation
from skatemount.envs.robots.layout import JointLayout
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.terms import TaskContext


def _joints(layout: JointLayout, params: dict[str, Any]) -> int:
    return layout.num_joints


def _feet(layout: JointLayout, params: dict[str, Any]) -> int:
    return layout.num_feet


def _feet_points(layout: JointLayout, params: dict[str, Any]) -> int:
    return 3 * layout.num_feet


@observation(3, "axial")
def base_ang_vel(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the angular velocity of the trunk, trunk frame, ``[N, 3]`` rad/s."""
    return sim.base_ang_vel


@observation(3, "vector")
def base_lin_vel(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the linear velocity of the trunk, trunk frame, ``[N, 3]`` m/s."""
    return sim.base_lin_vel


@observation(3, "vector")
def gravity(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the direction of gravity in the trunk frame, ``[N, 3]``; upright is (0, 0, -1)."""
    return sim.gravity


@observation(3, "command")
def command(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the velocity command, ``[N, 3]``: forward and left in m/s, turn left in rad/s."""
    return episode.command


@observation(3, "ride")
def ride_command(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the command of a ride, ``[N, 3]``: phase, speed in m/s and curvature in 1/m; 0 if none is commanded."""
    command = episode.ride_command
    return torch.zeros_like(episode.command) if command is None else command


@observation(_joints, "joints")
def joint_pos(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the joint angles relative to the default pose, ``[N, J]`` rad."""
    return sim.joint_pos - context.default_pose


@observation(_joints, "joints")
def joint_vel(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the joint velocities, ``[N, J]`` rad/s."""
    return sim.joint_vel


@observation(_joints, "joints")
def last_action(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the clipped action of the last step, ``[N, J]``."""
    return episode.action


@observation(1, "scalars")
def board_age(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the time since the board's pose that all terms about the board use was measured, ``[N, 1]`` s."""
    age = sim.base_pos.new_zeros(len(sim.base_pos)) if sim.board_age is None else sim.board_age
    return age.unsqueeze(-1)


@observation(3, "vector")
def board_pos(
    sim: SimState, episode: EpisodeState, context: TaskContext, at: Literal["deck", "ground"] = "deck"
) -> Tensor:
    """Return the position of the board in the trunk frame, ``[N, 3]`` m.

    Args:
        sim: The state.
        episode: The episode.
        context: Constants.
        at: ``deck`` for the center of the deck's top. ``ground`` for the point below it along the board's z axis, at
            the distance of the deck's height (paper's code).
    """
    if at == "deck":
        return sim.board_pos_base
    return sim.board_pos_base - context.deck_height_of(sim) * sim.board_rot_base[..., 2]


@observation(6, "vector")
def board_axes(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the board's x and z axes in the trunk frame, ``[N, 6]``; x points to the end that the trunk faces."""
    return torch.cat((sim.board_rot_base[..., 0] * episode.board_direction, sim.board_rot_base[..., 2]), -1)


@observation(1, None)
def board_yaw(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the yaw of the board in the trunk frame, ``[N, 1]`` rad in [0, 2 pi), as the paper's code does.

    The value jumps where the board's x axis passes the trunk's.
    """
    x_axis = sim.board_rot_base[..., 0]
    return torch.atan2(x_axis[:, 1], x_axis[:, 0]).remainder(2 * torch.pi).unsqueeze(-1)


def outline_points(deck_half: tuple[float, float], points: int) -> Tensor:
    """Place points at equal arc length around the deck's top edge, starting mid-front and going left.

    Args:
        deck_half: Half length and half width of the deck, m.
        points: Number of points.

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


def _rotation_to_points(points: Tensor, device: torch.device) -> Tensor:
    """Build the matrix that maps a board's rotation to its rotated points.

    One product of two matrices is faster than a small product in every world.

    Args:
        points: ``[P, 3]`` in the board frame, m.
        device: Device of the result.

    Returns:
        ``[9, 3 P]``; a flattened rotation matrix ``[9]`` times it is the rotated points ``[3 P]``, m.
    """
    # Cached for later calls, including ones that need gradients.
    with torch.inference_mode(False):
        return torch.einsum("ik,pj->ijpk", torch.eye(3), points.clone()).reshape(9, -1).to(device)


def _points_in_trunk_frame(sim: SimState, axes: Tensor, matrix: Tensor) -> Tensor:
    """Transform points of the board to the trunk frame.

    Args:
        sim: The state.
        axes: ``[N, 3, 3]`` board axes in the trunk frame (columns).
        matrix: ``[9, 3 P]`` from `_rotation_to_points`.

    Returns:
        ``[N, 3 P]`` m.
    """
    # The position is added and not part of the product, because training may round products more coarsely than float32.
    return ((axes.flatten(1) @ matrix).view(len(axes), -1, 3) + sim.board_pos_base.unsqueeze(1)).flatten(1)


def outlines(deck_half: Tensor, points: int) -> Tensor:
    """Place points around decks of different sizes, as `outline_points` does around one.

    The position after an arc s has the coordinates x = clamp(|s - 2 (a + b)| - (a + b), -a, a) and, on the left half,
    y = min(s, b, 2 (a + b) - s), with a and b the half length and half width.

    Args:
        deck_half: ``[N, 2]`` half length and half width of each deck, m.
        points: Number of points, P.

    Returns:
        ``[N, P, 3]`` in the board frame, m.
    """
    a, b = deck_half.split(1, 1)
    side = a + b
    arc = torch.arange(points, device=deck_half.device) / points * (4 * side)
    back = arc > 2 * side
    x = torch.minimum(torch.maximum((arc - 2 * side).abs() - side, -a), a)
    left = torch.where(back, arc - 2 * side, arc)
    y = torch.minimum(torch.minimum(left, b), 2 * side - left) * torch.where(back, -1.0, 1.0)
    return torch.stack((x, y, torch.zeros_like(x)), -1)


def _own_points_in_trunk_frame(sim: SimState, axes: Tensor, points: Tensor) -> Tensor:
    """Transform points of each world's board to the trunk frame.

    Args:
        sim: The state.
        axes: ``[N, 3, 3]`` board axes in the trunk frame (columns).
        points: ``[N, P, 3]`` in the board frame, m.

    Returns:
        ``[N, 3 P]`` m.
    """
    return (points @ axes.mT + sim.board_pos_base.unsqueeze(1)).flatten(1)


@observation(lambda layout, params: 3 * params.get("points", 16), "outline")
def outline(sim: SimState, episode: EpisodeState, context: TaskContext, points: int = 16) -> Tensor:
    """Return points at equal arc length around the deck's top edge, trunk frame, ``[N, 3 points]`` m.

    The first point is the middle of the end that the trunk faces.
    """
    axes = sim.board_rot_base * _facing_signs(episode)
    if sim.board_sizes is not None:
        return _own_points_in_trunk_frame(sim, axes, outlines(sim.board_sizes[:, :2], points))
    return _points_in_trunk_frame(sim, axes, _outline(context.deck_half, points, sim.base_pos.device))


@functools.lru_cache(64)
def _outline(deck_half: tuple[float, float], points: int, device: torch.device) -> Tensor:
    return _rotation_to_points(outline_points(deck_half, points), device)


@observation(72, None)
def outline_paper(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the 24 edge points of the paper's code in the trunk frame, ``[N, 72]`` m.

    The points go around the deck in steps of 0.083 m, 12 mm above its top. They overshoot the corners as in the paper's
    code: on the short edges they end 82 mm outside.
    """
    if sim.board_sizes is not None:
        return _own_points_in_trunk_frame(sim, sim.board_rot_base, _paper_points(sim.board_sizes[:, :2]))
    return _points_in_trunk_frame(sim, sim.board_rot_base, _paper_outline(context.deck_half, sim.base_pos.device))


@functools.lru_cache(64)
def _paper_outline(deck_half: tuple[float, float], device: torch.device) -> Tensor:
    half_x, half_y = deck_half
    step = 0.083
    long_edge = [-half_x + step * i for i in range(8)]
    short_edge = [-half_y + step * (i + 1) for i in range(4)]
    points = [(x, -half_y) for x in long_edge] + [(half_x, y) for y in short_edge]
    points += [(-x, half_y) for x in long_edge] + [(-half_x, -y) for y in short_edge]
    return _rotation_to_points(torch.tensor([(x, y, 0.012) for x, y in points]), device)


def _paper_points(deck_half: Tensor) -> Tensor:
    """Return the points of `_paper_outline` for boards of their own, ``[N, 24, 3]`` m.

    Args:
        deck_half: ``[N, 2]`` half length and half width of each deck, m.
    """
    steps = 0.083 * torch.arange(8, device=deck_half.device)
    half_x, half_y = deck_half.split(1, 1)
    ones = torch.ones_like(steps)
    long_edge = torch.stack((steps - half_x, -half_y * ones), -1)
    short_edge = torch.stack((half_x * ones[:4], steps[1:5] - half_y), -1)
    half = torch.cat((long_edge, short_edge), 1)
    return torch.nn.functional.pad(torch.cat((half, -half), 1), (0, 1), value=0.012)


@observation(_feet_points, "feet")
def feet_base(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the centers of the feet in the trunk frame, ``[N, 3 F]`` m."""
    return sim.foot_pos_base.flatten(1)


@observation(_feet_points, None)
def feet_base_left_first(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the centers of the feet in the trunk frame, ``[N, 3 F]`` m, left and right exchanged.

    The A1's order is then FL, FR, RL, RR, as in the paper's code.
    """
    return sim.foot_pos_base[:, list(context.layout.mirror_legs)].flatten(1)


@observation(_feet_points, "feet")
def feet_board(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the centers of the feet in the board frame, ``[N, 3 F]`` m; x points to the end that the trunk faces."""
    return (sim.foot_pos_board * _facing_signs(episode)).flatten(1)


def _facing_signs(episode: EpisodeState) -> Tensor:
    """Return the signs of the board's x, y and z axes that point x to the end that the trunk faces, ``[N, 1, 3]``."""
    return torch.nn.functional.pad(episode.board_direction.expand(-1, 2), (0, 1), value=1.0).unsqueeze(1)


@observation(_feet, "flags")
def on_deck(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return 1 for each foot that presses on the deck from above, else 0, ``[N, F]``."""
    return episode.on_deck.to(sim.base_pos.dtype)


@observation(_feet, "flags")
def off_time(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the time since each foot last pressed on the deck, at most 1 s, ``[N, F]`` s."""
    return episode.off_time.clamp(max=1.0)


@observation(_feet, "flags")
def deck_touch(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return 1 for each foot with any force against the deck, else 0, ``[N, F]`` (paper's code, no threshold)."""
    return (sim.foot_deck_force != 0).any(-1).to(sim.base_pos.dtype)


@observation(lambda layout, params: 2 * layout.num_feet, "flags_twice")
def foot_forces(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the contact force of each foot with the deck, then with anything else, ``[N, 2 F]`` in units of 100 N."""
    forces = torch.cat((sim.foot_deck_force, sim.foot_other_force), 1)
    return torch.linalg.vector_norm(forces, dim=-1) * 0.01


@observation(lambda layout, params: layout.num_bodies, "bodies")
def body_contacts(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return 1 for each robot body other than the feet that touches something, else 0, ``[N, B]``."""
    return success.body_contacts(sim).to(sim.base_pos.dtype)


@observation(6, "vector_axial")
def board_velocity(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the linear and angular velocity of the board in the trunk frame, ``[N, 6]`` m/s and rad/s."""
    both = torch.stack((sim.board_lin_vel, sim.board_ang_vel), 1)
    return rotate_inverse(sim.base_rot, both).flatten(1)


@observation(2, "negative")
def truck_angle(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the angles of the trucks about their axes, ``[N, 2]`` rad; the end that the trunk faces comes first."""
    return torch.where(episode.board_direction > 0, sim.truck_angle, sim.truck_angle.flip(-1))


@observation(3, "scalars")
def heights(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the heights of trunk and deck above the robot's floor (m), and 1 if the board is welded, ``[N, 3]``."""
    fixed = sim.board_fixed.to(sim.base_pos.dtype)
    base, deck = sim.base_pos[:, 2] - sim.ground_height, sim.board_pos[:, 2] - sim.ground_height
    return torch.stack((base, deck, fixed), 1)


@observation(1, "scalars")
def mounted_time(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the time that the robot has been mounted without a break, at most 1 s, ``[N, 1]`` s."""
    return episode.mounted_time.clamp(max=HOLD).unsqueeze(-1)


@observation(8, "scalars")
def dynamics(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the physics that `randomization`, `boards` and `sensing` drew for the world, ``[N, 8]``.

    Factor of the friction; mass added to the trunk, kg; mass of the deck, kg; stiffness of the trucks, N m/rad; factors
    of the position gain, the velocity gain and the torque limit; delay of the targets, s.
    """
    return episode.dynamics
