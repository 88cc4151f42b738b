"""The task `gait`: follow velocity commands."""

from __future__ import annotations

from torch import Tensor

from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.tasks.definition import Metric, TaskDefinition, TrainingValue
from skatemount.envs.tasks.metrics import ENERGY
from skatemount.envs.tasks.registry import TASKS
from skatemount.envs.terms import TaskContext

MAX_VELOCITY_ERROR = 0.25
"""Bound on the mean error of the horizontal velocity of a robot that follows its command, m/s."""
MAX_TURN_ERROR = 0.3
"""Bound on the mean error of the turning rate of a robot that follows its command, rad/s."""


def mean_error(episode: EpisodeState) -> Tensor:
    """Compute the mean errors of the horizontal velocity and of the turning rate since the start.

    Args:
        episode: The episodes.

    Returns:
        ``[N, 2]`` m/s and rad/s.
    """
    return episode.command_error / episode.step.clamp(min=1).unsqueeze(1)


def followed(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Test whether the robot followed its commands: mean errors below 0.25 m/s and 0.3 rad/s, ``[N]`` bool."""
    mean = mean_error(episode)
    return (mean[:, 0] < MAX_VELOCITY_ERROR) & (mean[:, 1] < MAX_TURN_ERROR)


def velocity_error(episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the mean error of the horizontal velocity, ``[N]`` m/s."""
    return mean_error(episode)[:, 0]


def turn_error(episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the mean error of the turning rate, ``[N]`` rad/s."""
    return mean_error(episode)[:, 1]


GAIT = TASKS.register(
    TaskDefinition(
        name="gait",
        description="walk under velocity commands, with nothing to mount",
        success=followed,
        failure="not_followed",
        failure_words="did not follow the command",
        metrics=(
            Metric(
                name="velocity_error",
                label="velocity error",
                meaning="difference between the horizontal velocity and the command, mean over the episode",
                measure=lambda sim, episode, context: velocity_error(episode, context),
                unit="m/s",
                training=TrainingValue(velocity_error),
            ),
            Metric(
                name="turn_error",
                label="turn error",
                meaning="difference between the turning rate and the command, mean over the episode",
                measure=lambda sim, episode, context: turn_error(episode, context),
                unit="rad/s",
                training=TrainingValue(turn_error),
            ),
            ENERGY,
        ),
        score={"velocity_error": -0.01},
        overview=("velocity_error", "turn_error"),
        progress=("velocity_error",),
        uses_command=True,
        start_curricula=False,
    )
)
