"""States of rollouts in which a robot is stuck, half-mounted, as starts: the way out of them is practised."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from skatemount.envs import success
from skatemount.envs.geometry import quat_from_matrix, rotate
from skatemount.envs.mdp import StepResult
from skatemount.envs.mount_env import MountEnv
from skatemount.envs.physics.base import StartState
from skatemount.envs.sampling import uniform
from skatemount.envs.state import EpisodeState, SimState

SIZE = 4096
"""States kept; a new one takes the place of the oldest."""
PER_STEP = 16
"""Most states taken from one control step, so that what is kept comes from many moments."""
MAX_TILT = math.radians(5.0)
"""Of the deck: boards start level, and the robot's feet must still be where they were."""
STUCK_AFTER = 2.0
"""Half-mounted this long after a foot first pressed on the deck, a robot is not on its way any more, s."""


def half_mounted(sim: SimState, episode: EpisodeState) -> Tensor:
    """Whether one to three feet press on a deck that is level, under an upright robot, ``[N]`` bool.

    Args:
        sim: The state.
        episode: The episodes.
    """
    feet = episode.on_deck.sum(1)
    upright = -sim.gravity[:, 2] > math.cos(success.MAX_TRUNK_TILT)
    return (feet > 0) & (feet < 4) & upright & (success.deck_level(sim) > math.cos(MAX_TILT))


def to_start_states(sim: SimState, deck_height: float) -> StartState:
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
    return StartState(
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


class StuckStateBuffer:
    """Collects half-mounted states of an environment, and lets a share of its starts be such states.

    It is filled anew after a resume, within an iteration or two.

    Args:
        env: The environment; it is listened to, and its starts are changed from the next draw on.
        share: Of the starts in the stage's own ranges.
        after: What is kept is older than this, seconds from the first foot-deck contact.
    """

    def __init__(self, env: MountEnv, share: float, after: float = STUCK_AFTER):
        self._env, self._share, self._after = env, share, after
        self._kept: StartState | None = None
        env.listeners.append(self.observe_step)
        env.set_start_transform(self.replace_fraction)

    def observe_step(self, episode: EpisodeState, outcome: StepResult, done: Tensor) -> None:
        """Keep some of a step's states of stuck robots; a listener of `MountEnv`."""
        env = self._env
        trying = episode.step * env.mdp.context.control_step - episode.first_contact
        rows = (half_mounted(env.sim, episode) & (trying > self._after) & ~done).nonzero().flatten()
        if not len(rows):
            return
        rows = rows[torch.randperm(len(rows), generator=env.generator, device=rows.device)[:PER_STEP]]
        # Mypy does not see tensorclass's own.
        new = to_start_states(env.sim[rows], env.task.scene.deck_height)  # type: ignore[index]
        self._kept = new if self._kept is None else StartState.cat([self._kept, new])[-SIZE:]

    def replace_fraction(self, starts: StartState, generator: torch.Generator) -> StartState:
        """Put kept states in the place of a share of starts that belong to no bin; the wrench on the trunk stays.

        Args:
            starts: As drawn.
            generator: Source of randomness.
        """
        if self._kept is None:
            return starts
        n = len(starts)
        replaced = (uniform((n,), generator) < self._share) & (starts.bin < 0)
        picked = self._kept[torch.randint(len(self._kept), (n,), generator=generator, device=generator.device)]
        picked.force, picked.torque = starts.force, starts.torque
        return StartState.where(replaced, picked, starts)
