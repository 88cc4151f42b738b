"""Settings of the task: everything a `MountTask` is built from."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from skatemount.envs.commands import CommandConfig
from skatemount.envs.entities.a1 import A1Config
from skatemount.envs.entities.skateboard import SkateboardConfig
from skatemount.envs.observations import ObservationTerm
from skatemount.envs.physics.base import PhysicsConfig
from skatemount.envs.randomization import RandomizationConfig
from skatemount.envs.rewards import RewardTerm
from skatemount.envs.starts import StartConfig
from skatemount.envs.success import CRITERIA
from skatemount.envs.terminations import TerminationTerm
from skatemount.errors import ConfigError


@dataclass
class ObservationConfig:
    """What is seen.

    Attributes:
        policy: Terms of the actor's observation, in order.
        privileged: Terms that only the critic sees besides.
        noise: Whether the policy's terms get their noise.
    """

    policy: dict[str, ObservationTerm] = field(default_factory=dict)
    privileged: dict[str, ObservationTerm] = field(default_factory=dict)
    noise: bool = True


@dataclass
class TaskConfig:
    """Settings of the task.

    Attributes:
        episode_length: Seconds.
        success: What an episode must achieve: ``mount`` (stand on the board at its end) or ``gait`` (follow the
            command).
        robot: The A1.
        board: The skateboard.
        physics: Time step, solver, engine.
        observation: What is seen.
        reward: Reward terms by name.
        termination: Termination terms by name.
        start: Start states.
        command: Velocity commands.
        randomization: Randomised physics and pushes.
    """

    episode_length: float = 5.0
    success: str = "mount"
    robot: A1Config = field(default_factory=A1Config)
    board: SkateboardConfig = field(default_factory=SkateboardConfig)
    physics: PhysicsConfig = field(default_factory=PhysicsConfig)
    observation: ObservationConfig = field(default_factory=ObservationConfig)
    reward: dict[str, RewardTerm] = field(default_factory=dict)
    termination: dict[str, TerminationTerm] = field(default_factory=dict)
    start: StartConfig = field(default_factory=StartConfig)
    command: CommandConfig = field(default_factory=CommandConfig)
    randomization: RandomizationConfig = field(default_factory=RandomizationConfig)

    def validate(self) -> None:
        """Raise `ConfigError` for the first setting that cannot be used."""
        if not 0 < self.episode_length < math.inf:
            raise ConfigError(f"episode_length={self.episode_length} must be above 0 seconds, and finite")
        if self.success not in CRITERIA:
            raise ConfigError(f"success={self.success} must be one of {', '.join(CRITERIA)}")
        for part in ("robot", "board", "physics", "start", "command", "randomization"):
            getattr(self, part).validate(part)
