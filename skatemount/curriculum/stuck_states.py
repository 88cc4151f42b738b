"""Initial states from rollouts in which a robot was stuck half-mounted, so that it practices to get out of them."""

from __future__ import annotations

import dataclasses
import math

import torch
from torch import Tensor

from skatemount.envs import success
from skatemount.envs.boards import AnyBoard
from skatemount.envs.geometry import quat_from_matrix, rotate
from skatemount.envs.mdp import StepResult
from skatemount.envs.mount_env import MountEnv
from skatemount.envs.physics.base import StartState
from skatemount.envs.sampling import uniform
from skatemount.envs.starts import start_from_state
from skatemount.envs.state import EpisodeState, SimState

SIZE = 4096
"""Capacity of the buffer in states; new states replace the oldest."""
PER_STEP = 16
"""Largest number of states taken from one control step, so that the buffer holds states of many steps."""
MAX_TILT = math.radians(5.0)
"""Largest tilt of the deck, rad. Boards start level, and a small tilt keeps the feet where they were."""
STUCK_AFTER = 2.0
"""Time from the first contact between foot and deck after which a half-mounted robot counts as stuck, s."""


def half_mounted(sim: SimState, episode: EpisodeState) -> Tensor:
    """Return the worlds in which some but not all feet of an upright robot press on a level deck, ``[N]`` bool.

    Args:
        sim: ``[N]`` states.
        episode: ``[N]`` episodes.
    """
    feet = episode.on_deck.sum(1)
    upright = -sim.gravity[:, 2] > math.cos(success.MAX_TRUNK_TILT)
    return (feet > 0) & (feet < episode.on_deck.shape[1]) & upright & (success.deck_level(sim) > math.cos(MAX_TILT))


def to_start_states(sim: SimState, board: AnyBoard) -> StartState:
    """Turn states into initial states, with robot and board moved together to the board's usual initial pose.

    Args:
        sim: ``[N]`` states.
        board: Settings of the board, or sizes of ``[N]`` boards.

    Returns:
        ``[N]`` initial states without an external wrench and with bin -1.
    """
    to_board = sim.board_rot.transpose(-1, -2)
    turned = to_board @ sim.base_rot
    position = rotate(to_board, sim.base_pos - sim.board_pos)
    position[:, 2] += board.deck_height
    return dataclasses.replace(
        start_from_state(sim, board),
        base_pos=position,
        base_quat=quat_from_matrix(turned),
        base_lin_vel=rotate(turned, sim.base_lin_vel),
        board_speed=rotate(to_board, sim.board_lin_vel)[:, 0] * ~sim.board_fixed,
        board_xy=None,
        board_lift=None,
        board_yaw=None,
        board_yaw_rate=None,
        board_lean=None,
        truck_angle=None,
    )


class StuckStateBuffer:
    """A buffer of stuck, half-mounted states of an environment, from which a share of its episodes begin.

    If boards vary, a state is used in the world that it comes from only, because its feet stand on that world's deck.

    Args:
        env: The environment. The buffer listens to it and transforms the initial states drawn from now on.
        share: Share of the starts in the stage's own ranges that is replaced.
        after: Time from the first contact between foot and deck before a state is kept, s.
    """

    def __init__(self, env: MountEnv, share: float, after: float = STUCK_AFTER):
        self._env, self._share, self._after = env, share, after
        self._kept: StartState | None = None
        env.listeners.append(self.observe_step)
        env.set_start_transform(self.replace_fraction)

    def observe_step(self, episode: EpisodeState, outcome: StepResult, done: Tensor) -> None:
        """Keep some states of stuck robots from a control step; a listener of `MountEnv`.

        Args:
            episode: ``[N]`` episodes after the step.
            outcome: Result of the step.
            done: ``[N]`` bool, episodes that ended.
        """
        env = self._env
        since_contact = episode.step * env.mdp.context.control_step - episode.first_contact
        rows = (half_mounted(env.sim, episode) & (since_contact > self._after) & ~done).nonzero().flatten()
        if not len(rows):
            return
        rows = rows[torch.randperm(len(rows), generator=env.generator, device=rows.device)[:PER_STEP]]
        # Mypy does not know the indexing of a tensorclass.
        sim = env.sim[rows]  # type: ignore[index]
        if env.boards is None:
            new = to_start_states(sim, env.task.config.board)
        else:
            new = to_start_states(sim, env.boards.sizes[rows].to(torch.float32))
            new.world = rows
        self._kept = new if self._kept is None else StartState.cat([self._kept, new])[-SIZE:]

    def replace_fraction(self, starts: StartState, generator: torch.Generator) -> StartState:
        """Replace a share of the initial states without a bin by kept states; the wrench on the trunk stays.

        Args:
            starts: ``[n]`` initial states as drawn.
            generator: Source of randomness.

        Returns:
            ``[n]`` initial states.
        """
        if self._kept is None:
            return starts
        n = len(starts)
        replaced = (uniform((n,), generator) < self._share) & (starts.bin < 0)
        if starts.world is None:
            chosen = torch.randint(len(self._kept), (n,), generator=generator, device=generator.device)
        else:
            chosen, found = self._of_same_world(starts.world, generator)
            replaced &= found
        picked = self._kept[chosen]
        picked.force, picked.torque = starts.force, starts.torque
        return StartState.where(replaced, picked, starts)

    def _of_same_world(self, worlds: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Choose a kept state of the same world for each initial state, because it fits that world's board.

        Args:
            worlds: ``[n]`` int64.
            generator: Source of randomness.

        Returns:
            ``[n]`` int64, index of the kept state, and ``[n]`` bool, whether there is one.
        """
        assert self._kept is not None and self._kept.world is not None
        order = self._kept.world.argsort(stable=True)
        counts = torch.bincount(self._kept.world, minlength=self._env.num_worlds)
        number = (uniform((len(worlds),), generator) * counts[worlds]).long()
        first = counts.cumsum(0) - counts
        place = (first[worlds] + number).clamp(max=len(order) - 1)
        return order[place], counts[worlds] > 0

    def state_dict(self) -> dict[str, Tensor]:
        """Return the kept states by field; empty if there are none yet."""
        return {} if self._kept is None else self._kept.state_dict()

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restore what `state_dict` returned."""
        self._kept = StartState.from_state_dict(state, self._env.device) if state else None
