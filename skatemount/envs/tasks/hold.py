"""The task `hold`: stay mounted on a board that rolls."""

from __future__ import annotations

from torch import Tensor

from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.success import FLICKER
from skatemount.envs.tasks.definition import Metric, TaskDefinition
from skatemount.envs.tasks.measures import board_speed, integral, is_mounted
from skatemount.envs.tasks.metrics import ENERGY, SLIPS
from skatemount.envs.tasks.registry import TASKS
from skatemount.envs.terms import TaskContext


def held(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Test whether the robot was mounted for the whole episode, ``[N]`` bool.

    The first 0.1 s are forgiven, as every break of a foot's contact is, because a robot that starts just above the deck
    first lands on it. A robot is mounted only while the deck is within 30 degrees of level, so the board stays on its
    wheels.
    """
    elapsed = episode.step * context.control_step
    # The millisecond covers float32's rounding of a sum of control steps.
    return episode.mounted_time >= elapsed - FLICKER - 1e-3


TASKS.register(
    TaskDefinition(
        name="hold",
        description="stay mounted on a rolling board for the whole episode",
        success=held,
        failure="not_held",
        failure_words="not mounted all the time",
        metrics=(
            Metric(
                name="time_on_deck",
                label="time on the deck",
                meaning="time during which the robot was mounted",
                measure=integral(is_mounted),
                unit="s",
                note="an episode",
            ),
            Metric(
                name="distance_rolled",
                label="distance rolled",
                meaning="length of the path of the deck's center, in the plane",
                measure=integral(board_speed),
                unit="m",
                reducer="median",
            ),
            Metric(
                name="final_board_speed",
                label="board speed at the end",
                meaning="horizontal speed of the deck's center in the last step; only episodes that lasted until the "
                "time limit count",
                measure=board_speed,
                unit="m/s",
                reducer="median",
                counts="complete",
            ),
            SLIPS,
            ENERGY,
        ),
        score={"time_on_deck": 0.01},
        overview=("time_on_deck", "distance_rolled", "final_board_speed"),
        progress=("time_on_deck",),
        state_word="mounted",
        in_state=is_mounted,
        start_curricula=False,
    )
)
