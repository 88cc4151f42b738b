"""The task `mount_and_ride`: mount a board, then ride it as commanded."""

from __future__ import annotations

from dataclasses import replace

from torch import Tensor

from skatemount.envs.riding import ride_of
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.tasks.definition import Metric, TaskDefinition, TrainingValue
from skatemount.envs.tasks.measures import is_mounted
from skatemount.envs.tasks.registry import TASKS
from skatemount.envs.tasks.ride import RIDE_METRICS, follows
from skatemount.envs.terms import TaskContext

RIDE_TIME = 10.0
"""Time for which a ride must last until the time limit, s."""


def mounted_and_rode(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Test whether the robot has ridden for the last 10 s at least, and followed its commands, ``[N]`` bool.

    A ride begins once the robot has been mounted for the time of ``command.ride_after``, and ends when it is no longer
    mounted. `skatemount.envs.tasks.ride.follows` judges the whole ride.
    """
    ride = ride_of(episode, context)
    return (ride.seconds >= RIDE_TIME - context.control_step / 2) & follows(ride)


def ride_time(episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the length of the present ride, ``[N]`` s; 0 without one."""
    return ride_of(episode, context).seconds


def _of_successes(metric: Metric) -> Metric:
    """Return a metric whose value in trainings is that of successes, because other episodes may have no ride."""
    return metric if metric.training is None else replace(metric, training=replace(metric.training, over="success"))


TASKS.register(
    TaskDefinition(
        name="mount_and_ride",
        description="mount a board, then ride it as commanded for 10 s",
        success=mounted_and_rode,
        failure="not_ridden",
        failure_words="no ride of 10 s on course",
        metrics=(
            Metric(
                name="ride_time",
                label="time of the ride",
                meaning="length of the ride that lasts until the end",
                measure=lambda sim, episode, context: ride_time(episode, context),
                unit="s",
                note="an episode",
                training=TrainingValue(ride_time),
            ),
            *(_of_successes(metric) for metric in RIDE_METRICS),
        ),
        score={"yaw_rate_error": -0.1, "ride_time": 0.01},
        overview=("ride_time", "yaw_rate_error", "time_on_deck"),
        progress=("ride_time", "yaw_rate_error"),
        state_word="mounted",
        in_state=is_mounted,
        uses_command=True,
        start_curricula=True,
    )
)
