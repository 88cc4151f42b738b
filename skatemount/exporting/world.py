"""The graph of what a simulation computes after the physics: the robot's sensors, success, and loads on the board."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import torch
from torch import Tensor

from skatemount.envs.drive import Drive
from skatemount.envs.rolling import RollingResistance
from skatemount.envs.scene import SceneIndex
from skatemount.envs.sensing import Sensing
from skatemount.envs.state import EpisodeState, SimState, StateReader
from skatemount.envs.task import MountTask
from skatemount.exporting.observe import ON_DECK
from skatemount.exporting.onnx_graph import MEMORY, NEXT, Values, make_graph
from skatemount.utils.errors import ConfigError

JUDGED = ("terminations", "truncated", "succeeded", "mounted", "elapsed")
"""Outputs about the episode: the terminations that are true, whether the time limit ended it, whether it succeeded,
whether the robot is mounted now, and the control steps since the start."""


SENSED = "sensed."
"""Prefix of the outputs that are measurements, the inputs of `skatemount.exporting.observe.Observe`."""


class Tap:
    """The sensors of a decision process, of which each result is kept.

    Args:
        sensing: The sensors.

    Attributes:
        sensed: The last sensed state.
        seen: The last episodes with the contacts that the sensors show.
        drawn: Errors of the next step, see `Sensing.sense`; they are drawn if None.
    """

    sensed: SimState
    seen: EpisodeState

    def __init__(self, sensing: Sensing):
        self._sensing = sensing
        self.drawn: Tensor | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._sensing, name)

    def begin(self, sim: SimState, episode: EpisodeState, rows: Tensor | None = None) -> SimState:
        """Sense start states; see `Sensing.begin`."""
        self.sensed = self._sensing.begin(sim, episode, rows)
        return self.sensed

    def sense(self, sim: SimState, episode: EpisodeState) -> SimState:
        """Sense the states after a step; see `Sensing.sense`."""
        self.sensed = self._sensing.sense(sim, episode, self.drawn)
        return self.sensed

    def contacts(self, episode: EpisodeState, rows: Tensor | None = None) -> EpisodeState:
        """Return the contacts that the sensors show; see `Sensing.contacts`."""
        self.seen = self._sensing.contacts(episode, rows)
        return self.seen

    def measured(self) -> dict[str, Tensor]:
        """Return what the robot measured last, by the names of `Observe`'s inputs."""
        sensed = dict(self.sensed.items())  # type: ignore[attr-defined]  # Mypy does not know tensorclass's methods.
        sensed.setdefault("board_age", torch.zeros(len(sensed["base_pos"])))
        return {**sensed, ON_DECK: self.seen.on_deck}


class _Nothing:
    """A stand-in for a table of terms that a graph does not need."""

    memory = ()

    def __call__(self, *arguments: Any) -> Tensor:
        return torch.zeros(1, 1)

    def update(self, sim: SimState, episode: EpisodeState) -> None:
        """Leave the command as it is."""


class World:
    """A control step of one world after the physics: `skatemount.envs.mdp.Mdp.advance` as a function of tensors.

    Args:
        task: The task.
        index: Ids of its compiled scene.
        resistance: Rolling resistance of the board.
        drive: Force that keeps the board rolling.

    Raises:
        ConfigError: A termination has a memory of its own.
    """

    def __init__(self, task: MountTask, index: SceneIndex, resistance: RollingResistance, drive: Drive):
        self.mdp = mdp = task.make_mdp(torch.Generator())
        for term in mdp.terminations.memory:
            raise ConfigError(f"{term.where} has a memory of its own and cannot be exported; leave it out")
        self._index, self._reader = index, StateReader(index)
        self._resistance, self._drive = resistance, drive
        self.tap = Tap(mdp.sensing)
        # Neither rewards nor observations are part of this graph, and the command comes from `Observe`.
        nothing: Any = _Nothing()
        mdp.sensing, mdp.rewards, mdp.privileged = self.tap, nothing, nothing  # type: ignore[assignment]
        mdp.observation, mdp.commands = nothing, nothing

    def inputs(self, sensors: int, memory: Values) -> Values:
        """Return example inputs.

        Args:
            sensors: Size of MuJoCo's ``sensordata``.
            memory: Example of the sensors' memory, `Sensing.state_dict` of one world.
        """
        layout = self.mdp.context.layout
        episode = dict(EpisodeState.zeros(1, layout).items())  # type: ignore[attr-defined]
        return {
            "sensordata": torch.zeros(1, sensors),
            "joint_acc": torch.zeros(1, layout.num_joints),
            "ground_height": torch.zeros(1),
            "board_fixed": torch.zeros(1, dtype=torch.bool),
            "followed": torch.zeros(1, 3),
            "errors": torch.zeros(1, self.tap.noise_size),
            **{f"{MEMORY}episode.{name}": value for name, value in episode.items() if name != "command"},
            **{f"{MEMORY}sensing.{name}": value for name, value in memory.items()},
        }

    def __call__(self, values: Values) -> Values:
        """Return measurements, the state of the episode, loads, and the memory of the next step."""
        mdp = self.mdp
        sim = self._reader.read(
            values["sensordata"], values["joint_acc"], values["ground_height"], values["board_fixed"]
        )
        kept = {name.removeprefix(MEMORY): value for name, value in values.items() if name.startswith(MEMORY)}
        of_episode = {name[8:]: value for name, value in kept.items() if name.startswith("episode.")}
        episode = EpisodeState(**of_episode, command=values["followed"], batch_size=[1])
        self.tap._memory.clear()
        self.tap._memory.update({name[8:]: value for name, value in kept.items() if name.startswith("sensing.")})
        self.tap.drawn = values["errors"]
        joints = mdp.context.layout.num_joints
        outcome = mdp.advance(sim, episode, torch.zeros(1, joints), torch.zeros(1, dtype=torch.bool))
        results = {
            # The last row is of worlds whose physics failed, which the simulation itself notices.
            "terminations": outcome.termination_flags[:-1].t(),
            "truncated": outcome.truncated,
            "succeeded": outcome.succeeded,
            "mounted": episode.mounted,
            "elapsed": episode.step,
            "target_offset": self.tap.targets(torch.zeros(1, joints)),
            **{SENSED + name: value for name, value in self.tap.measured().items()},
        }
        if self._resistance.active:
            results["wheel_friction"] = self._resistance.joint_friction(sim)
        if self._drive.active:
            results["board_force"] = self._drive.force(sim)
        after = dict(episode.items())  # type: ignore[attr-defined]
        results |= {f"{NEXT}episode.{name}": value for name, value in after.items() if name != "command"}
        return results | {f"{NEXT}sensing.{name}": value for name, value in self.tap._memory.items()}


def world_graph(world: World, sensors: int, memory: Values, measurements: Collection[str], offset: bool) -> Any:
    """Return the graph of a world, ``onnx.ModelProto``.

    Args:
        world: The world's function.
        sensors: Size of MuJoCo's ``sensordata``.
        memory: Example of the sensors' memory.
        measurements: Names of the measurements that the observation needs.
        offset: Whether encoders have offsets, which their controllers' targets need.
    """
    wanted = {*JUDGED, *(SENSED + name for name in measurements), "wheel_friction", "board_force"}
    if offset:
        wanted.add("target_offset")
    return make_graph(world, world.inputs(sensors, memory), wanted.__contains__)
