"""Velocity commands: sampled from ranges, or computed from the board's pose."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from skatemount.envs.config.commands import COMMANDS, MODES, CommandConfig
from skatemount.envs.sampling import uniform
from skatemount.envs.state import EpisodeState, SimState
from skatemount.utils.classes import made


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

    Attributes:
        fixed: ``[3]`` or ``[N, 3]``, a command that every world gets in place of that of the settings, such as one from
            a keyboard; None for that of the settings.
    """

    def __init__(
        self, config: CommandConfig, control_step: float, generator: torch.Generator, deck_height: float = 0.0
    ):
        config.validate()
        self.fixed: Tensor | None = None
        self._depth = deck_height if config.board_point == "ground" else 0.0
        self._config = config
        self._steps = max(1, round(config.resample / control_step))
        self._generator = generator
        self._bounds = torch.tensor([config.forward, config.left, config.turn], device=generator.device)
        own = None if config.mode in MODES else COMMANDS.find(config.mode, "command.mode")
        where = f"command.mode={config.mode}"
        self._own = None if own is None else made(own, where, config, control_step, generator)

    def update(self, sim: SimState, episode: EpisodeState) -> None:
        """Set the command of every world for the next step, in place.

        Args:
            sim: The state.
            episode: The episodes. With sampled commands, a world whose ``command_steps`` have run out gets a new one.
        """
        if self.fixed is not None:
            episode.command = self.fixed.expand_as(episode.command).clone()
        elif self._own is not None:
            self._own.update(sim, episode)
        elif self._config.mode == "board":
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

    def _draw(self, n: int) -> Tensor:
        c, bounds = self._config, self._bounds
        fraction = uniform((n, 3), self._generator)
        command = bounds[:, 0] + (bounds[:, 1] - bounds[:, 0]) * fraction
        slow = torch.linalg.vector_norm(command[:, :2], dim=-1, keepdim=True) < c.deadband
        command[:, :2] = torch.where(slow, 0.0, command[:, :2])
        standing = uniform((n, 1), self._generator) < c.standing
        return torch.where(standing, 0.0, command)
