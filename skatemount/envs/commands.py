"""Velocity commands: sampled for the gait, computed from the board's pose elsewhere."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from skatemount.envs.config.commands import CommandConfig
from skatemount.envs.sampling import uniform
from skatemount.envs.state import EpisodeState, SimState


def toward_board(sim: SimState, direction: Tensor | None = None) -> Tensor:
    """Velocity command toward the board, the law of the paper's code.

    With p the board's place in the trunk's frame, psi its yaw and theta the bearing of p: within 0.5 m
    (2 p_x, 2 p_y, psi / pi), farther away (1 - |theta| / pi, 0, theta / pi).

    Args:
        sim: The state.
        direction: ``[N, 1]`` which end psi is the yaw of, as in `EpisodeState.board_direction`; if not given, the end
            that the board's x axis points to (the paper's code).

    Returns:
        ``[N, 3]`` forward, left (m/s), turn left (rad/s).
    """
    place, x_axis = sim.board_pos_base, sim.board_rot_base[..., 0]
    if direction is not None:
        x_axis = x_axis * direction
    yaw = torch.atan2(x_axis[:, 1], x_axis[:, 0]) / math.pi
    bearing = torch.atan2(place[:, 1], place[:, 0]) / math.pi
    near = torch.linalg.vector_norm(place[:, :2], dim=-1) < 0.5
    close = torch.stack((2 * place[:, 0], 2 * place[:, 1], yaw), 1)
    far = torch.stack((1 - bearing.abs(), torch.zeros_like(bearing), bearing), 1)
    return torch.where(near.unsqueeze(1), close, far)


class CommandGenerator:
    """Keeps the velocity command of every world.

    Args:
        config: Where commands come from.
        control_step: Seconds between two actions.
        generator: Source of randomness.
    """

    def __init__(self, config: CommandConfig, control_step: float, generator: torch.Generator):
        config.validate()
        self._config = config
        self._steps = max(1, round(config.resample / control_step))
        self._generator = generator
        self._bounds = torch.tensor([config.forward, config.left, config.turn], device=generator.device)

    def update(self, sim: SimState, episode: EpisodeState) -> None:
        """Set the command of every world for the next step, in place.

        Args:
            sim: The state.
            episode: The episodes; a world whose ``command_steps`` have run out gets a new sampled command.
        """
        if self._config.mode == "board":
            episode.command = toward_board(sim, episode.board_direction if self._config.turn_to == "nearer" else None)
        elif self._config.mode == "sampled":
            due = episode.command_steps <= 0
            episode.command = torch.where(due.unsqueeze(1), self._draw(len(due)), episode.command)
            left = torch.where(due, self._steps, episode.command_steps)
            episode.command_steps = left - 1

    def _draw(self, n: int) -> Tensor:
        c, bounds = self._config, self._bounds
        share = uniform((n, 3), self._generator)
        command = bounds[:, 0] + (bounds[:, 1] - bounds[:, 0]) * share
        slow = torch.linalg.vector_norm(command[:, :2], dim=-1, keepdim=True) < c.deadband
        command[:, :2] = torch.where(slow, 0.0, command[:, :2])
        standing = uniform((n, 1), self._generator) < c.standing
        return torch.where(standing, 0.0, command)
