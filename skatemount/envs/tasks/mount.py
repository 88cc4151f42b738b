"""The task `mount`: be mounted on the board at the end of the episode."""

from __future__ import annotations

import torch
from torch import Tensor

from skatemount.envs.config.task import HOLD
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.tasks.definition import Metric, TaskDefinition, TrainingValue
from skatemount.envs.tasks.measures import FeetOnBoard, feet_now, is_mounted
from skatemount.envs.tasks.metrics import BOARD_DISPLACEMENT, ENERGY, SLIPS
from skatemount.envs.tasks.registry import TASKS
from skatemount.envs.terms import TaskContext


def stood(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Test whether the robot was mounted throughout the last second, ``[N]`` bool."""
    return episode.mounted_time >= HOLD - context.control_step / 2


def time_to_mount(episode: EpisodeState, context: TaskContext) -> Tensor:
    """Compute the time from the first foot-deck contact to the start of the present mounted stretch, ``[N]`` s.

    It means something only for an episode that has succeeded.
    """
    elapsed = episode.step * context.control_step
    return (elapsed - episode.mounted_time - episode.first_contact).clamp(min=0.0)


def known_time_to_mount(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return `time_to_mount`, nan without any contact, ``[N]`` s."""
    return torch.where(episode.first_contact.isfinite(), time_to_mount(episode, context), torch.nan)


MOUNT = TASKS.register(
    TaskDefinition(
        name="mount",
        description="be mounted on the board throughout the last second of the episode",
        success=stood,
        failure="not_mounted",
        failure_words="not mounted at the time limit",
        metrics=(
            Metric(
                name="time_to_mount",
                label="time to mount",
                meaning="from the first contact of a foot with the deck to the moment from which the robot stays "
                "mounted",
                measure=known_time_to_mount,
                unit="s",
                reducer="median",
                counts="success",
                training=TrainingValue(time_to_mount, over="success"),
                of_one="mounted {} after the first contact",
            ),
            Metric(
                name="feet_on_board",
                label="feet on board",
                meaning="mean number of feet that press on the deck in the last second; 0 if the episode ended early",
                measure=FeetOnBoard,
                counts="complete",
                otherwise=0.0,
                note="in the last second",
                most=lambda layout: layout.num_feet,
                training=TrainingValue(feet_now, over="steps"),
            ),
            BOARD_DISPLACEMENT,
            SLIPS,
            ENERGY,
        ),
        score={"feet_on_board": 0.01},
        overview=("time_to_mount", "feet_on_board"),
        progress=("feet_on_board",),
        state_word="mounted",
        in_state=is_mounted,
    )
)
