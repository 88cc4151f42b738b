"""The graph that turns measurements of a robot into the policy's observation."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from skatemount.envs.commands import CommandGenerator
from skatemount.envs.geometry import board_direction
from skatemount.envs.legs import Legs
from skatemount.envs.mdp import Mdp
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.task import MountTask
from skatemount.exporting.onnx_graph import MEMORY, NEXT, Values, make_graph
from skatemount.utils.errors import ConfigError

EXPORTED = ("sampled", "board", "zero")
"""Values of ``command.mode`` that an exported policy can have."""

DERIVED = ("foot_pos_base", "foot_pos_board")
"""Fields of `SimState` that follow from the joint angles and the board's pose."""

BEGINS, COMMAND, NOISE, ON_DECK = "begins", "command", "noise", "on_deck"
"""Inputs in addition to the fields of `SimState`: 1 in the first call of an episode, the velocity command (unless it is
computed from the board's pose), noise of the terms from -1 to 1, and the feet that press on the deck."""


class Observe:
    """The policy's observation as a function of measurements and memory, for one robot.

    It calls the terms of the task, so it cannot differ from them. Feet are computed from the joint angles, and their
    places on the board from its pose, as a robot has to.

    Args:
        task: The task.

    Raises:
        ConfigError: A part of the task needs something that a graph cannot have.
    """

    def __init__(self, task: MountTask):
        self._mdp = mdp = task.make_mdp(torch.Generator())
        self._task, self._legs = task, Legs(task.scene.robot.spec)
        self.mode = task.config.command.mode
        if self.mode not in EXPORTED:
            raise ConfigError(f"command.mode={self.mode} cannot be exported; use one of {', '.join(EXPORTED)}")
        context = mdp.context
        self._commands = CommandGenerator(
            task.config.command, context.control_step, torch.Generator(), context.deck_height
        )
        for term in mdp.observation.memory:
            raise ConfigError(f"{term.where} has a memory of its own and cannot be exported; leave it out")

    def inputs(self) -> Values:
        """Return example inputs: every field of `SimState`, and what else an observation may depend on."""
        layout = self._mdp.context.layout
        sim, episode = SimState.at_rest(1, layout), EpisodeState.zeros(1, layout)
        fields = {name: value for name, value in _tensors(sim).items() if name not in DERIVED}
        others = {f"episode.{name}": value for name, value in _tensors(episode).items()}
        memory = {
            "action": torch.zeros(1, layout.num_joints),
            "board_direction": torch.ones(1, 1),
            "off_time": torch.zeros(1, layout.num_feet),
            "observation": torch.zeros(1, self._mdp.observation.size),
        }
        return {
            BEGINS: torch.ones(1, 1, dtype=torch.bool),
            **fields,
            "board_age": torch.zeros(1),
            ON_DECK: torch.zeros(1, layout.num_feet, dtype=torch.bool),
            COMMAND: torch.zeros(1, 3),
            NOISE: torch.zeros(1, frame_size(self._mdp)),
            **others,
            **{MEMORY + name: value for name, value in memory.items()},
        }

    def __call__(self, values: Values) -> Values:
        """Return the observation, the command that it contains, and the memory of the next step."""
        mdp, layout, begins = self._mdp, self._mdp.context.layout, values[BEGINS]
        fields = {name: values[name] for name in _tensors(SimState.at_rest(1, layout)) if name not in DERIVED}
        feet = self._legs.feet(fields["joint_pos"])
        to_foot = feet - fields["board_pos_base"].unsqueeze(1)
        sim = SimState(
            **fields,
            board_age=values["board_age"],
            foot_pos_base=feet,
            foot_pos_board=to_foot @ fields["board_rot_base"],
            batch_size=[1],
        )
        others = {name: values[f"episode.{name}"] for name in _tensors(EpisodeState.zeros(1, layout))}
        episode = EpisodeState(**others, batch_size=[1])
        clip = self._task.scene.robot.config.action_clip
        episode.action = torch.where(begins, 0.0, values[f"{MEMORY}action"].clamp(-clip, clip))
        rotation, before = sim.board_rot_base, values[f"{MEMORY}board_direction"]
        episode.board_direction = torch.where(begins, board_direction(rotation), board_direction(rotation, before))
        episode.on_deck = values[ON_DECK]
        since = torch.where(begins, math.inf, values[f"{MEMORY}off_time"] + mdp.context.control_step)
        episode.off_time = torch.where(episode.on_deck, 0.0, since)
        episode.command = values[COMMAND] if self.mode == "sampled" else torch.zeros(1, 3)
        if self.mode == "board":
            self._commands.update(sim, episode)
        table, noise = mdp.observation, values[NOISE] if has_noise(self._task) else None
        later = table(sim, episode, noise, values[f"{MEMORY}observation"])
        observation = torch.where(begins, table(sim, episode, noise), later)
        return {
            "observation": observation,
            "commanded": episode.command,
            f"{NEXT}board_direction": episode.board_direction,
            f"{NEXT}off_time": episode.off_time,
            f"{NEXT}observation": observation,
        }


def frame_size(mdp: Mdp) -> int:
    """Return the number of values in one frame of the policy's observation."""
    return sum(part["size"] // part.get("history_length", 1) for part in mdp.observation.layout())


def has_noise(task: MountTask) -> bool:
    """Return whether the terms of the policy's observation have noise of their own."""
    config = task.config
    terms = config.observation.policy.values()
    return config.observation.noise and config.sensing.term_noise and any(term.noise > 0 for term in terms)


def observe_graph(task: MountTask) -> Any:
    """Return the graph of a task's observation, ``onnx.ModelProto``.

    Args:
        task: The task.

    Raises:
        ConfigError: A part of the task cannot be exported.
    """
    function = Observe(task)
    model = make_graph(function, function.inputs())
    for each in model.graph.input:
        if each.name.startswith("episode."):
            raise ConfigError(
                f"observation.policy reads {each.name.removeprefix('episode.')} of the episode, which a robot cannot "
                "know; leave out the term that does"
            )
    return model


def _tensors(state: Any) -> dict[str, Tensor]:
    return dict(state.items())
