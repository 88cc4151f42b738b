"""States of earlier episodes as starts: robots that are stuck, half-mounted, and starts from which they failed."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from skatemount.envs import success
from skatemount.envs.geometry import quat_from_matrix, rotate
from skatemount.envs.mdp import Outcome
from skatemount.envs.mount_env import MountEnv
from skatemount.envs.physics.base import WorldStart
from skatemount.envs.random import uniform
from skatemount.envs.state import EpisodeState, SimState

SIZE = 4096
"""States kept; a new one takes the place of the oldest."""
PER_STEP = 16
"""Most states taken from one control step, so that what is kept comes from many moments."""
MAX_TILT = math.radians(5.0)
"""Of the deck: boards start level, and the robot's feet must still be where they were."""
STUCK_AFTER = 2.0
"""Half-mounted this long after a foot first pressed on the deck, a robot is not on its way any more, s."""
OWN, AGAIN = -1, -2
"""What `WorldStart.bin` is of starts in the stage's own ranges, and of those that an earlier episode has left."""


def half_mounted(sim: SimState, episode: EpisodeState) -> Tensor:
    """Whether one to three feet press on a deck that is level, under an upright robot, ``[N]`` bool.

    Args:
        sim: The state.
        episode: The episodes.
    """
    feet = episode.on_deck.sum(1)
    upright = -sim.gravity[:, 2] > math.cos(success.MAX_TRUNK_TILT)
    return (feet > 0) & (feet < 4) & upright & (success.deck_level(sim) > math.cos(MAX_TILT))


def as_starts(sim: SimState, deck_height: float) -> WorldStart:
    """States as starts: robot and board moved together to where boards start, level and along the x axis.

    Args:
        sim: ``[N]`` states.
        deck_height: Of the board at rest, m.

    Returns:
        ``[N]``; no wrench, and part of no curriculum.
    """
    n = len(sim.base_pos)
    to_board = sim.board_rot.transpose(-1, -2)
    turned = to_board @ sim.base_rot
    position = rotate(to_board, sim.base_pos - sim.board_pos)
    position[:, 2] += deck_height
    return WorldStart(
        base_pos=position,
        base_quat=quat_from_matrix(turned),
        base_lin_vel=rotate(turned, sim.base_lin_vel),
        base_ang_vel=sim.base_ang_vel.clone(),
        joint_pos=sim.joint_pos.clone(),
        joint_vel=sim.joint_vel.clone(),
        ground_height=sim.ground_height.clone(),
        board_fixed=sim.board_fixed.clone(),
        board_speed=rotate(to_board, sim.board_lin_vel)[:, 0] * ~sim.board_fixed,
        force=torch.zeros_like(position),
        torque=torch.zeros_like(position),
        bin=torch.full((n,), -1, device=position.device),
    )


class Harvest:
    """Lets a share of an environment's starts be states of its earlier episodes: robots that are stuck, and failures.

    Both are kept in memory alone: after a resume it is filled anew, within an iteration or two.

    Args:
        env: The environment; it is listened to, and its starts are changed from the next draw on.
        stuck: Share of the starts in the stage's own ranges that are states in which a robot was half-mounted.
        failed: Share of them that are the starts of episodes that failed. What fails again is not counted twice, or
            soon hardly anything but hopeless starts would be left.
        after: A half-mounted state is kept if it is older than this, seconds from the first foot-deck contact.
    """

    def __init__(self, env: MountEnv, stuck: float, failed: float = 0.0, after: float = STUCK_AFTER):
        self._env, self._after = env, after
        self._shares = {"stuck": stuck, "failed": failed}
        self._kept: dict[str, WorldStart] = {}
        self._steps = 0
        env.listeners.append(self.record)
        env.change_starts(self.mix)

    def record(self, episode: EpisodeState, outcome: Outcome, done: Tensor) -> None:
        """Keep some of a step's stuck robots, and where failed episodes started; a listener of `MountEnv`."""
        env, context = self._env, self._env.mdp.context
        self._steps += 1
        if self._shares["stuck"]:
            trying = episode.step * context.control_step - episode.first_contact
            rows = self._some(half_mounted(env.sim, episode) & (trying > self._after) & ~done)
            if len(rows):
                # Mypy does not see tensorclass's own.
                self._keep("stuck", as_starts(env.sim[rows], env.task.scene.deck_height))  # type: ignore[index]
        # The first episodes may have begun in the middle.
        if self._shares["failed"] and self._steps > context.episode_steps:
            rows = self._some(done & ~outcome.succeeded & (episode.bin == OWN))
            if len(rows):
                self._keep("failed", env.starts[rows])

    def _some(self, mask: Tensor) -> Tensor:
        """At most `PER_STEP` rows of a mask."""
        rows = mask.nonzero().flatten()
        if not len(rows):
            return rows
        return rows[torch.randperm(len(rows), generator=self._env.generator, device=rows.device)[:PER_STEP]]

    def _keep(self, kind: str, new: WorldStart) -> None:
        kept = self._kept.get(kind)
        self._kept[kind] = (new if kept is None else WorldStart.cat([kept, new]))[-SIZE:]

    def mix(self, starts: WorldStart, generator: torch.Generator) -> WorldStart:
        """Put kept states in the place of a share of starts that belong to no bin; the wrench on the trunk stays.

        Args:
            starts: As drawn.
            generator: Source of randomness.
        """
        if not self._kept:
            return starts
        n, low, own = len(starts), 0.0, starts.bin == OWN
        chance = uniform((n,), generator)
        for kind, kept in self._kept.items():
            high = low + self._shares[kind]
            picked = kept[torch.randint(len(kept), (n,), generator=generator, device=generator.device)]
            picked.force, picked.torque = starts.force, starts.torque
            picked.bin = torch.full_like(starts.bin, AGAIN)
            starts = WorldStart.where((chance >= low) & (chance < high) & own, picked, starts)
            low = high
        return starts
