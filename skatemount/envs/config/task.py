"""Settings of the task, from which a `MountTask` is built."""

from __future__ import annotations

import functools
from dataclasses import dataclass, field, fields
from typing import Any

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from skatemount.envs.config.board import SkateboardConfig
from skatemount.envs.config.boards import BoardsConfig
from skatemount.envs.config.commands import CommandConfig
from skatemount.envs.config.physics import PhysicsConfig
from skatemount.envs.config.randomization import RandomizationConfig
from skatemount.envs.config.robot import RobotConfig
from skatemount.envs.config.sensing import SensingConfig
from skatemount.envs.config.starts import StartConfig
from skatemount.envs.config.terms import ObservationTerm, RewardTerm, TerminationTerm
from skatemount.utils.bounds import check_bounds, number
from skatemount.utils.errors import ConfigError

HOLD = 1.0
"""Time that the robot must have been mounted at the end of an episode, s."""


@functools.cache
def _schema(kind: type) -> Any:
    """Return a dataclass as a schema; a merge copies it, and making it takes longer than the rest of a row."""
    return OmegaConf.structured(kind)


def _terms(kind: type, table: dict[str, Any], where: str) -> dict[str, Any]:
    """Convert the rows of a table to dataclasses.

    The settings declare a table as a dict of any values, because Hydra could not add a row (`reward.still.weight=1`) to
    a dict of dataclasses.

    Args:
        kind: Dataclass of a row.
        table: Rows by name of the term.
        where: Name of the table in the configuration, for messages.

    Returns:
        Dataclasses by name of the term.

    Raises:
        ConfigError: A row has an unknown key or a value of the wrong type.
    """
    rows = {}
    for name, row in table.items():
        if isinstance(row, kind):
            rows[name] = row
            continue
        known = [f.name for f in fields(kind)]
        if row is not None and not isinstance(row, dict):
            raise ConfigError(f"{where}.{name}={row} must be the settings of a term: {', '.join(known)}")
        for key, value in (row or {}).items():
            if key not in known:
                raise ConfigError(f"{where}.{name}.{key}={value} is not a setting of a term; known: {', '.join(known)}")
        try:
            rows[name] = OmegaConf.to_object(OmegaConf.merge(_schema(kind), row or {}))
        except (OmegaConfBaseException, ValueError) as error:
            said = str(error).splitlines()[0]
            raise ConfigError(f"{where}.{name}={row}: {said}") from error
    return rows


@dataclass
class ObservationConfig:
    """Settings of the observations.

    Attributes:
        policy: `ObservationTerm` by name, in the order of the policy's observation.
        privileged: `ObservationTerm` by name, in the order of the values that only the critic gets in addition.
        noise: True if noise is added to the policy's terms.
        history_length: Number of frames of the policy's terms that do not set their own: the present frame and those of
            the control steps before it.
    """

    policy: dict[str, Any]
    privileged: dict[str, Any]
    noise: bool
    history_length: int = field(metadata=number(1, 100))

    def __post_init__(self) -> None:
        self.policy = _terms(ObservationTerm, self.policy, "observation.policy")
        self.privileged = _terms(ObservationTerm, self.privileged, "observation.privileged")


@dataclass
class TaskConfig:
    """Settings of the task.

    Attributes:
        episode_length: Time limit of an episode, s.
        success: Name of the task (`skatemount.envs.tasks`): its success criterion, metrics and score. ``task=<name>``
            sets it together with the start states, commands and terms that belong to it.
        robot: Settings of the robot.
        board: Settings of the skateboard.
        boards: Ranges of the boards, if every world has a board of its own.
        physics: Settings of time stepping, solver and engine.
        observation: Settings of the observations.
        reward: `RewardTerm` by name.
        termination: `TerminationTerm` by name.
        start: Ranges of the start states.
        command: Settings of the velocity commands.
        randomization: Ranges of randomized physics and pushes.
        sensing: Errors and delays of the robot's sensors, and delay of its targets.
        plugins: Modules that register terms of one's own, imported before the tables are checked.
    """

    episode_length: float = field(metadata=number(0, 3600, "s", above=True))
    success: str
    robot: RobotConfig
    board: SkateboardConfig
    boards: BoardsConfig
    physics: PhysicsConfig
    observation: ObservationConfig
    reward: dict[str, Any]
    termination: dict[str, Any]
    start: StartConfig
    command: CommandConfig
    randomization: RandomizationConfig
    sensing: SensingConfig
    plugins: list[str]

    def __post_init__(self) -> None:
        self.reward = _terms(RewardTerm, self.reward, "reward")
        self.termination = _terms(TerminationTerm, self.termination, "termination")

    def validate(self) -> None:
        """Raise `ConfigError` for the first setting that cannot be used."""
        check_bounds(self, "")
        self._validate_tables()
        for name, term in self.observation.privileged.items():
            if term.history_length not in (None, 1):
                raise ConfigError(
                    f"observation.privileged.{name}.history_length={term.history_length} must be null; only terms of "
                    "the policy have a history"
                )
        for part in ("robot", "board", "boards", "physics", "start", "command", "randomization", "sensing"):
            getattr(self, part).validate(part)
        self.boards.validate_with(self.board)
        if self.episode_length < self.physics.control_step:
            raise ConfigError(
                f"episode_length={self.episode_length} must be at least a control step, physics.timestep times "
                f"physics.substeps, {self.physics.control_step:g} s"
            )

    def _validate_tables(self) -> None:
        check_bounds(self.observation, "observation")
        tables = {
            "reward": self.reward,
            "termination": self.termination,
            "observation.policy": self.observation.policy,
            "observation.privileged": self.observation.privileged,
        }
        for where, table in tables.items():
            if not table and where in ("reward", "termination"):
                off = "weight=0" if where == "reward" else "enabled=false"
                raise ConfigError(f"{where}={{}} must have at least one term; {off} switches a term off")
            if not table:
                raise ConfigError(f"{where}={{}} must have at least one term, such as base_lin_vel")
            for name, term in table.items():
                check_bounds(term, f"{where}.{name}")

    def validate_terms(self) -> None:
        """Raise `ConfigError` for an unknown task, or an unknown term or parameter in one of the tables."""
        # Imported here because the terms need torch, which takes seconds to import.
        from skatemount.envs.observations import OBSERVATIONS
        from skatemount.envs.rewards import REWARDS
        from skatemount.envs.tasks import TASKS
        from skatemount.envs.terminations import TERMINATIONS

        TASKS.get(self.success)
        tables = (
            (REWARDS, "reward", self.reward),
            (TERMINATIONS, "termination", self.termination),
            (OBSERVATIONS, "observation.policy", self.observation.policy),
            (OBSERVATIONS, "observation.privileged", self.observation.privileged),
        )
        for registry, where, table in tables:
            for name, term in table.items():
                registry.bind(name, term.params, where)
