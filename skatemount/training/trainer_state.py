"""`TrainerState`: what a checkpoint of a training keeps, and how a training or another rank goes on from it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from skatemount.curriculum.stuck_states import StuckStateBuffer
from skatemount.runs import checkpoint
from skatemount.runs.folder import RunFolder
from skatemount.training.guard import UpdateGuard
from skatemount.training.state import Attributes, CallbackStates, Generators, Stateful, load_parts, save_parts
from skatemount.utils.errors import ConfigError

if TYPE_CHECKING:
    from skatemount.training.trainer import Trainer

OF_A_RANK = ("generators", "env")
"""Parts that each rank has for itself; all others are the same on every rank."""


class TrainerState:
    """The state of a training.

    Args:
        trainer: The training.

    Attributes:
        memory: What the actor remembers between two iterations; see `skatemount.training.memory`.
        renormalizes: The next batch gives the statistics of the observations, and is not learned from.
        guard: Counts the updates that were undone.
    """

    def __init__(self, trainer: Trainer):
        self._trainer = trainer
        self.memory: dict[str, Tensor] = {}
        self.renormalizes = False
        self.guard = UpdateGuard()
        self._stuck_states: StuckStateBuffer | None = None
        if share := trainer.config.curriculum.stuck_start_fraction:
            self._stuck_states = StuckStateBuffer(trainer.env, share)
        self._of_others: dict[str, dict[str, Any]] = {}

    @property
    def parts(self) -> dict[str, Stateful]:
        """The named parts of the training state."""
        trainer = self._trainer
        # Saved runs have the name "ppo" for the state of any algorithm.
        parts: dict[str, Stateful] = {"networks": trainer.networks, "ppo": trainer.algorithm}
        if trainer.curriculum is not None:
            parts["curriculum"] = trainer.curriculum
        return parts | {
            "generators": Generators(trainer.env.physics.device, minibatches=trainer.minibatch_generator),
            "env": Generators(generator=trainer.env.generator),
            "guard": self.guard,
            "progress": Attributes(trainer, "frames", "iteration", "elapsed"),
            "callbacks": CallbackStates(trainer.callbacks),
        }

    def worlds(self) -> dict[str, Any]:
        """Return the state of every world of this process, and of what is kept from them."""
        kept = {} if self._stuck_states is None else {"stuck_states": self._stuck_states.state_dict()}
        return {"env": self._trainer.env.world_state(), "actor_memory": self.memory, **kept}

    def load_worlds(self, state: dict[str, Any]) -> None:
        """Restore what `worlds` returned."""
        env = self._trainer.env
        env.load_world_state(state["env"])
        self.memory = {key: value.to(env.device) for key, value in state["actor_memory"].items()}
        if self._stuck_states is not None:
            self._stuck_states.load_state_dict(state["stuck_states"])

    def saved(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return the training state and the state of the worlds for a checkpoint, with those of the other ranks."""
        state, worlds = save_parts(self.parts), self.worlds()
        state["progress"]["device"] = self._trainer.env.physics.device.type
        if others := self._trainer.ranks.gather():
            state["progress"]["ranks"] = self._trainer.ranks.size
            worlds["ranks"] = others
        return state, worlds

    def restore(self, folder: Path) -> None:
        """Restore everything from a checkpoint of the same run.

        Raises:
            ConfigError: It was trained on another kind of device, or does not fit.
        """
        trainer = self._trainer
        state = checkpoint.load_training_state(folder)
        device = trainer.env.physics.device.type
        if (there := state.get("progress", {}).get("device", device)) != device:
            raise ConfigError(
                f"physics.device={device}: {folder} was trained on {there} and resumes only there; init_from takes its "
                "policy to another device"
            )
        load_parts(self.parts, state, str(folder))
        self._restored()
        trainer.started_from = str(folder)
        worlds = checkpoint.load_world_state(folder)
        ranks, saved = trainer.ranks.size, state["progress"].get("ranks", 1)
        if worlds is None:
            print(f"{folder}: the state of its worlds is not saved, so their episodes begin again", flush=True)
        elif saved != ranks:
            print(
                f"{folder}: number of ranks {saved} when it was saved, {ranks} now: the policy, the optimizer and the "
                "statistics go on, and the episodes begin again",
                flush=True,
            )
        else:
            self._of_others = worlds.get("ranks", {})
            self.load_worlds(worlds)

    def _restored(self) -> None:
        """Bring what follows from the restored parts up to date."""
        trainer = self._trainer
        trainer.saved_frames = trainer.frames
        if trainer.curriculum is not None:
            trainer.env.set_start_sampler(trainer.curriculum.sample_poses)
        trainer.algorithm.step_schedules(trainer.frames, trainer.config.total_frames)

    # --- several ranks ---

    def of_rank(self) -> dict[str, Any]:
        """Return what only this rank has: its worlds, and its sources of randomness."""
        own = {name: part for name, part in self.parts.items() if name in OF_A_RANK}
        return {"parts": save_parts(own), "worlds": self.worlds()}

    def for_rank(self, rank: int) -> dict[str, Any]:
        """Return the state with which another rank begins, on rank 0; see `join`."""
        return {
            "run": str(self._trainer.run.path.absolute()),
            "renormalizes": self.renormalizes,
            "parts": {name: state for name, state in save_parts(self.parts).items() if name not in OF_A_RANK},
            "own": self._of_others.get(str(rank), {}),
        }

    def join(self, state: dict[str, Any]) -> None:
        """Take over the state of rank 0, and if as many ranks saved the run, this rank's own state.

        Args:
            state: What `for_rank` returned.
        """
        trainer, own = self._trainer, state["own"]
        trainer.run = RunFolder(Path(state["run"]))
        self.renormalizes = state["renormalizes"]
        states = state["parts"] | own.get("parts", {})
        load_parts({name: part for name, part in self.parts.items() if name in states}, states, "rank 0")
        if not trainer.frames:
            return
        self._restored()
        if own:
            self.load_worlds(own["worlds"])
            return
        # The numbers that this rank drew at the beginning of the run are used up.
        seed = trainer.config.seed + trainer.ranks.rank + trainer.frames
        torch.manual_seed(seed)
        trainer.minibatch_generator.manual_seed(seed)
        trainer.env.generator.manual_seed(seed)
