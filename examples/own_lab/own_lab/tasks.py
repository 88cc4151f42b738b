"""The lab's task: stand on the board without spilling the load."""

from __future__ import annotations

import torch
from torch import Tensor

from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.tasks import TASKS, Measure, Metric, TaskDefinition, TrainingValue, integral
from skatemount.envs.tasks.measures import power
from skatemount.envs.terms import TaskContext


def trunk_tilt(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the angle between the trunk's vertical axis and the world's, ``[N]`` degrees."""
    return torch.acos((-sim.gravity[:, 2]).clamp(-1.0, 1.0)).rad2deg()


def carried(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Test whether the robot is mounted with its trunk within 10 degrees of level, ``[N]`` bool."""
    return episode.mounted & (trunk_tilt(sim, episode, context) < 10.0)


class LargestTilt(Measure):
    """Largest tilt of the trunk in an episode, ``[N]`` degrees."""

    def begin(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> None:
        """Begin new episodes."""
        self.largest = trunk_tilt(sim, episode, context)

    def __call__(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
        """Return the largest tilt so far."""
        self.largest = torch.maximum(self.largest, trunk_tilt(sim, episode, context))
        return self.largest


TASKS.register(
    TaskDefinition(
        name="lab_carry",
        description="stand on the board at the end of the episode, with a level trunk",
        success=carried,
        failure="spilled",
        failure_words="not mounted with a level trunk at the time limit",
        metrics=(
            Metric("final_tilt", "tilt at the end", "tilt of the trunk in the last step", trunk_tilt, "degrees"),
            Metric("largest_tilt", "largest tilt", "largest tilt of the trunk", LargestTilt, "degrees", "median"),
            Metric(
                "feet",
                "feet on the deck",
                "number of feet that press on the deck in the last step",
                lambda sim, episode, context: episode.on_deck.sum(-1),
                most=lambda layout: layout.num_feet,
                training=TrainingValue(lambda episode, context: episode.on_deck.sum(-1), over="steps"),
            ),
            Metric("energy", "energy", "power of the joints, over time", integral(power), "J", counts="complete"),
        ),
        score={"largest_tilt": -0.001},
        overview=("largest_tilt", "feet"),
        progress=("feet",),
    )
)
