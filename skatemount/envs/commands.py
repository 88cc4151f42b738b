"""Commands: velocities, sampled from ranges or computed from the board's pose, and rides."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from skatemount.envs.config.commands import COMMANDS, MODES, CommandConfig
from skatemount.envs.riding import forward_speed
from skatemount.envs.sampling import uniform
from skatemount.envs.state import EpisodeState, SimState
from skatemount.utils.classes import made

_ROLLS = 0.05
"""Speed above which a board rolls, m/s."""


def toward_board(sim: SimState, direction: Tensor | None = None, depth: float | Tensor = 0.0) -> Tensor:
    """Compute the velocity command toward the board by the law of the paper's code.

    Let p be the board's position in the trunk frame, psi its yaw, and theta the bearing of p. Within 0.5 m the command
    is (2 p_x, 2 p_y, psi / pi), farther away it is (1 - |theta| / pi, 0, theta / pi).

    Args:
        sim: The state.
        direction: ``[N, 1]`` the end of the board that psi is the yaw of, as in `EpisodeState.board_direction`. If
            None, the end that the board's x axis points to (paper's code).
        depth: Distance of p below the center of the deck's top, along the board's z axis, m. The height of the deck
            gives the point on the ground that the paper's code uses. ``[N, 1]`` if boards vary.

    Returns:
        ``[N, 3]``: forward and left in m/s, turn left in rad/s.
    """
    position, x_axis = sim.board_pos_base, sim.board_rot_base[..., 0]
    if isinstance(depth, Tensor) or depth:
        position = position - depth * sim.board_rot_base[..., 2]
    if direction is not None:
        x_axis = x_axis * direction
    yaw = torch.atan2(x_axis[:, 1], x_axis[:, 0]) / math.pi
    bearing = torch.atan2(position[:, 1], position[:, 0]) / math.pi
    near = torch.linalg.vector_norm(position[:, :2], dim=-1) < 0.5
    close = torch.stack((2 * position[:, 0], 2 * position[:, 1], yaw), 1)
    far = torch.stack((1 - bearing.abs(), torch.zeros_like(bearing), bearing), 1)
    return torch.where(near.unsqueeze(1), close, far)


class CommandGenerator:
    """The velocity commands of a batch of worlds.

    Args:
        config: Settings of the commands.
        control_step: Time between two actions, s.
        generator: Source of randomness.
        deck_height: Height of the deck's top above the floor at rest, m; not used if boards vary.
        max_curvature: Largest curvature of the board's path, 1/m; not used if boards vary.

    Attributes:
        rides: True if rides are commanded.
        fixed: ``[3]`` or ``[N, 3]``, a command that every world gets in place of that of the settings, such as one from
            a keyboard; None for that of the settings.
        fixed_ride: ``[2]`` speed, m/s, and curvature, as a share of the largest one, that every ride gets in place of
            the sampled ones; None for the sampled ones.
    """

    def __init__(
        self,
        config: CommandConfig,
        control_step: float,
        generator: torch.Generator,
        deck_height: float = 0.0,
        max_curvature: float = 0.0,
    ):
        config.validate()
        self.fixed: Tensor | None = None
        self.fixed_ride: Tensor | None = None
        self.rides = config.mode == "ride"
        self._max_curvature = max_curvature
        self._begin_ride = round(config.ride_after / control_step) * control_step
        self._depth = deck_height if config.board_point == "ground" else 0.0
        self._config = config
        self._steps = max(1, round(config.resample / control_step))
        self._generator, self._control_step = generator, control_step
        self._bounds = torch.tensor([config.forward, config.left, config.turn], device=generator.device)
        own = None if config.mode in MODES else COMMANDS.find(config.mode, "command.mode")
        where = f"command.mode={config.mode}"
        self._own = None if own is None else made(own, where, config, control_step, generator)

    def update(self, sim: SimState, episode: EpisodeState) -> None:
        """Set the command of every world for the next step, in place.

        Args:
            sim: The state.
            episode: The episodes. With sampled commands or rides, a world whose ``command_steps`` have run out gets a
                new one.
        """
        if self.rides:
            self._update_rides(sim, episode)
        if self.fixed is not None:
            episode.command = self.fixed.expand_as(episode.command).clone()
        elif self._own is not None:
            self._own.update(sim, episode)
        elif self._config.mode in ("board", "ride"):
            direction = episode.board_direction if self._config.turn_to == "nearer" else None
            depth: float | Tensor = self._depth
            if depth and sim.board_sizes is not None:
                depth = sim.board_sizes[:, 2:3]
            episode.command = toward_board(sim, direction, depth)
        elif self._config.mode == "sampled":
            due = episode.command_steps <= 0
            episode.command = torch.where(due.unsqueeze(1), self._draw(len(due)), episode.command)
            remaining = torch.where(due, self._steps, episode.command_steps)
            episode.command_steps = remaining - 1

    def give(self, values: Sequence[float] | None) -> None:
        """Give every world a command in place of that of the settings, from the next step on.

        Args:
            values: A velocity command, forward and left in m/s and turn left in rad/s; or that of a ride, speed in m/s
                and curvature as a share of the largest one. None for those of the settings.
        """
        given = None if values is None else torch.tensor(values, device=self._generator.device)
        self.fixed = None if given is None or len(given) == 2 else given
        self.fixed_ride = given if self.fixed is None else None

    def _draw(self, n: int) -> Tensor:
        c, bounds = self._config, self._bounds
        fraction = uniform((n, 3), self._generator)
        command = bounds[:, 0] + (bounds[:, 1] - bounds[:, 0]) * fraction
        slow = torch.linalg.vector_norm(command[:, :2], dim=-1, keepdim=True) < c.deadband
        command[:, :2] = torch.where(slow, 0.0, command[:, :2])
        standing = uniform((n, 1), self._generator) < c.standing
        return torch.where(standing, 0.0, command)

    def _update_rides(self, sim: SimState, episode: EpisodeState) -> None:
        """Set the commands of the rides.

        A ride begins once the robot has been mounted for the time of the settings, and ends when it no longer is. The
        first commanded speed on a board that rolls is the board's own, within the limits of the settings.
        """
        before, steps, sums = episode.ride_command, episode.ride_steps, episode.ride_sums
        assert before is not None and steps is not None and sums is not None
        riding = episode.mounted_time >= self._begin_ride - self._control_step / 2
        begins = riding & (before[:, 0] == 0)
        due = riding & (begins | (episode.command_steps <= 0))
        c, n = self._config, len(riding)
        drawn = uniform((n, 3), self._generator)
        (slow, fast), (right, left) = c.speed, c.curvature
        speed = slow + (fast - slow) * drawn[:, 0]
        present = forward_speed(sim, episode)
        speed = torch.where(begins & (present > _ROLLS), present.clamp(slow, fast), speed)
        most = self._max_curvature if sim.board_sizes is None else sim.board_sizes[:, 6]
        share = right + (left - right) * drawn[:, 1]
        share = torch.where(drawn[:, 2] < c.standing, 0.0, share)
        if self.fixed_ride is not None:
            speed, share = self.fixed_ride.unsqueeze(1).expand(2, n)
            due = riding
        command = torch.stack((torch.ones_like(speed), speed, share * most), 1)
        command = torch.where(due.unsqueeze(1), command, before)
        goes_on = riding & ~begins
        episode.ride_command = torch.where(riding.unsqueeze(1), command, 0.0)
        episode.ride_steps = torch.where(goes_on, steps, 0)
        episode.ride_sums = torch.where(goes_on.unsqueeze(1), sums, 0.0)
        episode.command_steps = torch.where(due, self._steps, episode.command_steps) - 1
