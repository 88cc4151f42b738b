"""Rides: the motion of a board along its path, and how well it follows the commanded speed and curvature.

A robot steers a board by leaning it: the trucks turn with the lean, so the board rolls on a circle. A ride is commanded
by the speed v* of the board toward the end that the trunk faces, and by the curvature kappa* of its path, positive to
the left. Unlike a turning rate, a curvature can be followed at any speed: the largest one, 1 / R_min, is that at the
trucks' stops (`skatemount.envs.config.board.SkateboardConfig.max_curvature`).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.terms import TaskContext
from skatemount.utils.errors import ConfigError

LATE = 5.0
"""Time before the time limit over which `Ride` adds up the late part of a path, s."""


class Ride(NamedTuple):
    """Sums over the control steps of the present ride, ``[N]`` each; all are 0 while the robot does not ride.

    Attributes:
        seconds: Length of the ride, s.
        error: Integral of the error of the turning rate, |omega - kappa* v|, rad.
        commanded: Integral of the commanded turning rate, |kappa* v|, rad.
        speed_error: Integral of |v - v*|, m.
        speed: Integral of |v*|, m.
        turned: Change of the board's heading, rad, positive to the left.
        heading: Commanded change of the heading, the integral of kappa* v, rad.
        late_turned: Change of the heading in the last 5 s before the time limit, rad.
        late_distance: Distance rolled in the same time, m.
    """

    seconds: Tensor
    error: Tensor
    commanded: Tensor
    speed_error: Tensor
    speed: Tensor
    turned: Tensor
    heading: Tensor
    late_turned: Tensor
    late_distance: Tensor


def forward_speed(sim: SimState, episode: EpisodeState) -> Tensor:
    """Compute the speed of the deck's center along the board, toward the end that the trunk faces, ``[N]`` m/s."""
    along = torch.nn.functional.normalize(sim.board_rot[:, :2, 0], dim=1)
    return (sim.board_lin_vel[:, :2] * along).sum(1) * episode.board_direction[:, 0]


def lean_left(sim: SimState, episode: EpisodeState) -> Tensor:
    """Compute the lean of the deck to the left of the trunk, about its long axis, ``[N]`` rad."""
    # The height of the tip of the board's y axis is the sine of its lean to the right.
    return -torch.asin(sim.board_rot[:, 2, 1].clamp(-1, 1)) * episode.board_direction[:, 0]


def lean_of_curvature(curvature: Tensor, sim: SimState, context: TaskContext) -> Tensor:
    """Compute the lean of the deck with which the board rolls on a path of a curvature.

    gamma = asin(L kappa tan(theta) / 2), with L the wheelbase and theta the tilt of the trucks' axes from the vertical.
    This is the inverse of `skatemount.envs.config.board.SkateboardConfig.turning_radius`; HUSKY rewards the same lean
    (arXiv 2602.03205).

    Args:
        curvature: ``[N]`` 1/m, positive to the left.
        sim: The state.
        context: Constants of the task.

    Returns:
        ``[N]`` rad, positive to the left.
    """
    length, _ = context.steering_of(sim)
    return torch.asin((length * curvature).clamp(-1, 1))


def yaw_rate_error(sim: SimState, episode: EpisodeState) -> Tensor:
    """Compute the error of the board's turning rate, omega - kappa* v, ``[N]`` rad/s; 0 while no ride is commanded."""
    if (command := episode.ride_command) is None:
        return torch.zeros_like(sim.ground_height)
    phase, _, curvature = command.unbind(1)
    return phase * (sim.board_ang_vel[:, 2] - curvature * forward_speed(sim, episode))


def advance(sim: SimState, episode: EpisodeState, context: TaskContext) -> None:
    """Add a control step to the sums of the rides, in place; nothing happens if none is commanded.

    Args:
        sim: The state after the step.
        episode: The episodes after the step, with the command that was given in it.
        context: Constants of the task.
    """
    command, steps, sums = episode.ride_command, episode.ride_steps, episode.ride_sums
    if command is None or steps is None or sums is None:
        return
    phase, target, curvature = command.unbind(1)
    speed, rate = forward_speed(sim, episode), sim.board_ang_vel[:, 2]
    wanted = curvature * speed
    late = episode.step > context.episode_steps - round(LATE / context.control_step)
    rates = (
        (rate - wanted).abs(),
        wanted.abs(),
        (speed - target).abs(),
        target.abs(),
        rate,
        wanted,
        rate * late,
        speed.abs() * late,
    )
    # A failed world would spoil nothing but its own sums, which nobody reads.
    episode.ride_sums = sums + torch.stack(rates, 1) * (phase * context.control_step).unsqueeze(1)
    episode.ride_steps = steps + phase.to(steps.dtype)


def ride_of(episode: EpisodeState, context: TaskContext) -> Ride:
    """Return the sums of the present rides.

    Args:
        episode: The episodes.
        context: Constants of the task.

    Raises:
        ConfigError: No rides are commanded.
    """
    if episode.ride_steps is None or episode.ride_sums is None:
        raise ConfigError("a task that judges rides needs their commands; set command=ride")
    return Ride(episode.ride_steps * context.control_step, *episode.ride_sums.unbind(1))
