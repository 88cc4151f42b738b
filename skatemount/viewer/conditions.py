"""Conditions that a user changes while a policy acts: delays, noise, friction, and the start of an episode."""

from __future__ import annotations

import copy
import dataclasses
import math
from dataclasses import dataclass

import torch
from torch import Tensor

from skatemount.config import TrainConfig
from skatemount.config.files import load_file
from skatemount.envs.boards import boards_of
from skatemount.envs.config.boards import RANGES
from skatemount.envs.config.task import TaskConfig
from skatemount.envs.physics.base import StartState
from skatemount.envs.starts import StartPoses
from skatemount.evaluation.evaluator import EVALUATION_SEED, mix_seeds
from skatemount.evaluation.suite_task import EvaluationTask

NOISES = (
    "board_pos_bias",
    "board_rot_bias",
    "board_pos_jitter",
    "board_rot_jitter",
    "encoder_offset",
    "joint_vel_noise",
    "gyro_noise",
    "gravity_noise",
)
"""Settings of ``sensing`` that the noise multiplies."""


@dataclass
class Conditions:
    """Conditions in place of those of the task; None leaves what the task says.

    Attributes:
        target_delay: Time until the motors get a target, s.
        latency: Age of everything that the policy sees, control steps.
        noise: Factor of the errors of ``sensing=default``.
        friction: Factor of the friction of feet, deck and the robot's floor.
    """

    target_delay: float | None = None
    latency: int | None = None
    noise: float | None = None
    friction: float | None = None

    def applied(self, config: TrainConfig, seed: int) -> TrainConfig:
        """Return a copy of the task's settings with these conditions, and with one board if boards vary.

        Args:
            config: Settings of the task.
            seed: Seed of the worlds, which chooses the board.
        """
        config = copy.deepcopy(config)
        if config.boards.vary:
            # The worlds of a page are drawn with the same model.
            boards = boards_of(config.boards, config.board, seed)
            config.board = boards[seed % len(boards)]
            config.boards = dataclasses.replace(config.boards, **dict.fromkeys(RANGES), count=0, fixed=[])
        sensing = config.sensing
        if self.target_delay is not None:
            sensing.target_delay = [self.target_delay] * 2
        if self.latency is not None:
            sensing.latency = [self.latency] * 2
        if self.noise is not None:
            usual = load_file("sensing", "default")
            for name in NOISES:
                setattr(sensing, name, self.noise * float(usual[name]))
            sensing.term_noise = sensing.term_noise and not self.noise
        if self.friction is not None:
            config.randomization.friction = [self.friction] * 2
        return config

    def __str__(self) -> str:
        given = {name: value for name, value in dataclasses.asdict(self).items() if value is not None}
        return ", ".join(f"{name.replace('_', ' ')} {value:g}" for name, value in given.items())


@dataclass
class ChosenStart:
    """A start of the robot relative to the board.

    Attributes:
        distance: Of the trunk from the deck's center, m.
        bearing: Direction from the board to the robot, in the board's frame, degrees.
        heading: Direction that the robot faces, in the board's frame, degrees.
        board_speed: Of a free board along its x axis, m/s.
        board_fixed: True for a board that is welded to the world.
    """

    distance: float = 1.0
    bearing: float = 90.0
    heading: float = -90.0
    board_speed: float = 0.0
    board_fixed: bool = False

    def __str__(self) -> str:
        place = f"a start at {self.distance:g} m, bearing {self.bearing:g}°, heading {self.heading:g}°"
        return f"{place}, {'fixed' if self.board_fixed else 'free'} board"

    def poses(self, deck_height: float, device: torch.device, count: int) -> StartPoses:
        """Return this start as poses for `skatemount.envs.mount_env.MountEnv.set_start_sampler`.

        Args:
            deck_height: Height of the deck above the robot's floor, m.
            device: Device of the poses.
            count: Number of poses.
        """
        bearing = math.radians(self.bearing)
        place = [self.distance * math.cos(bearing), self.distance * math.sin(bearing)]
        with device:
            return StartPoses(
                xy=torch.tensor(place).repeat(count, 1),
                yaw=torch.full((count,), math.radians(self.heading)),
                step_height=torch.full((count,), deck_height),
                board_fixed=torch.full((count,), self.board_fixed),
                bin=torch.full((count,), -1),
            )

    def rolling(self, start: StartState, generator: torch.Generator) -> StartState:
        """Set the board's speed in start states; a `skatemount.envs.starts.StartTransform`."""
        start.board_speed = torch.where(start.board_fixed, 0.0, self.board_speed)
        return start


def same_worlds(one: TrainConfig, other: TrainConfig) -> bool:
    """Return whether two settings make the same worlds, whatever they say of the training and its seed."""
    names = [field.name for field in dataclasses.fields(TaskConfig)]
    return all(getattr(one, name) == getattr(other, name) for name in names if name != "seed")


def seed_of(task: EvaluationTask, variant: str) -> int:
    """Return the seed of the worlds of a variant, the same as that of its evaluation."""
    suite_seed = 0 if task.suite is None else task.suite.seed
    return mix_seeds(EVALUATION_SEED + task.seed, suite_seed, list(task.configs).index(variant))


def toward(axes: Tensor, speed: float, direction: float) -> Tensor:
    """Return ``[N, 3]`` horizontal velocities at an angle to the first of some axes, m/s.

    Args:
        axes: ``[N, 3, 3]`` axes (columns).
        speed: Size of the velocities, m/s.
        direction: Angle to the left of the first axis about the vertical, degrees.
    """
    angle = torch.atan2(axes[:, 1, 0], axes[:, 0, 0]) + math.radians(direction)
    return speed * torch.stack((angle.cos(), angle.sin(), torch.zeros_like(angle)), 1)
