"""Records of evaluated episodes, and the tracker that makes them."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from skatemount.envs import success
from skatemount.envs.mdp import StepResult
from skatemount.envs.mount_env import MountEnv
from skatemount.envs.state import EpisodeState, SimState

SLIP_SPEED = 0.25
"""Speed of a pressing foot along the deck that counts as a slip, m/s."""


@dataclass
class EpisodeRecords:
    """Measurements of N episodes.

    Attributes:
        number: ``[N]`` int64, number of the episode in the evaluation.
        variant: ``[N]`` int64, index of the suite's variant.
        start: ``[N, 3]`` initial x, y and yaw of the trunk in the board's frame, m and rad.
        board_fixed: ``[N]`` bool.
        success: ``[N]`` bool.
        end: ``[N]`` int64, 0 for the time limit, i for the i-th of `skatemount.envs.mdp.Mdp.termination_names`. If
            several were true in the last step, it is the first of them.
        duration: ``[N]`` s.
        mount_time: ``[N]`` time from the first contact with the deck to standing on it, s; nan for failures and for
            tasks without mounting.
        feet: ``[N]`` mean number of feet on the deck during the last second before the time limit; 0 if the episode
            ended earlier.
        displacement: ``[N]`` horizontal distance between the deck's center at the start and at the end, m.
        slips: ``[N]`` int64, number of slips; see `sliding`.
        energy: ``[N]`` sum over the control steps of `power` times the control step, J.
    """

    number: Tensor
    variant: Tensor
    start: Tensor
    board_fixed: Tensor
    success: Tensor
    end: Tensor
    duration: Tensor
    mount_time: Tensor
    feet: Tensor
    displacement: Tensor
    slips: Tensor
    energy: Tensor

    def __getitem__(self, rows: Tensor | slice) -> EpisodeRecords:
        """Return the records of some episodes."""
        return EpisodeRecords(**{name: value[rows] for name, value in vars(self).items()})

    def __len__(self) -> int:
        return len(self.number)

    @staticmethod
    def cat(parts: list[EpisodeRecords]) -> EpisodeRecords:
        """Concatenate records."""
        return EpisodeRecords(**{name: torch.cat([getattr(p, name) for p in parts]) for name in vars(parts[0])})


def sliding(sim: SimState, on_deck: Tensor) -> Tensor:
    """Return the feet that slide on the deck, ``[N, F]`` bool.

    A foot slides if it presses on the deck and its center moves along the deck's plane, relative to the board, faster
    than 0.25 m/s. A *slip* is a control step in which a foot slides and did not slide in the step before. One long
    slide counts once, and so does a foot that slides as it lands.

    Args:
        sim: The state.
        on_deck: ``[N, F]`` bool, feet that press on the deck.
    """
    return on_deck & (torch.linalg.vector_norm(sim.foot_vel_board[..., :2], dim=-1) > SLIP_SPEED)


def power(sim: SimState) -> Tensor:
    """Return the mechanical power of the joints, ``sum(|torque * velocity|)``, ``[N]``, W.

    Absolute values, because a motor that brakes does not give energy back.
    """
    return (sim.joint_torque * sim.joint_vel).abs().sum(-1)


class EpisodeTracker:
    """Measures one episode of every world of an environment.

    It is a listener of the environment, because what a step returns holds no physical state. Worlds whose episode has
    ended are still stepped; the tracker ignores them.

    Args:
        env: The environment.
    """

    def __init__(self, env: MountEnv):
        self._env = env
        context = env.mdp.context
        self._step = context.control_step
        self._last = min(context.episode_steps, max(1, round(success.HOLD / self._step)))
        self._first_counted = context.episode_steps - self._last

    def begin(self) -> None:
        """Begin new episodes; call after the environment's reset."""
        env, n = self._env, self._env.num_worlds
        self._board = env.sim.board_pos[:, :2].clone()
        self._start, self._fixed = env.episode.start.clone(), env.sim.board_fixed.clone()
        with self._board.device:
            self._sliding = torch.zeros(n, env.mdp.context.layout.num_feet, dtype=torch.bool)
            self._end, self._duration = torch.full((n,), -1), torch.zeros(n)
            self._success, self._mount_time = torch.zeros(n, dtype=torch.bool), torch.full((n,), torch.nan)
            self._feet, self._displacement = torch.zeros(n), torch.zeros(n)
            self._slips, self._energy = torch.zeros(n, dtype=torch.int64), torch.zeros(n)
        self._steps = 0

    @property
    def finished(self) -> bool:
        """True if the episodes of all worlds have ended."""
        return bool((self._end >= 0).all())

    def has_ended(self, world: int) -> bool:
        """Return True if a world's episode has ended."""
        return bool(self._end[world] >= 0)

    def add(self, episode: EpisodeState, outcome: StepResult, done: Tensor) -> None:
        """Add a control step to the measurements; a listener of `MountEnv`.

        Args:
            episode: The episodes after the step.
            outcome: Result of the step.
            done: ``[N]`` bool, episodes that ended.
        """
        sim = self._env.sim
        self._steps += 1
        running = self._end < 0
        # The last row is true where physics failed: the state of such a world means nothing.
        sound = running & ~outcome.termination_flags[-1]
        slides = sliding(sim, episode.on_deck)
        onsets = (slides & ~self._sliding).sum(-1)
        self._sliding = slides
        self._slips = torch.where(sound, self._slips + onsets, self._slips)
        self._energy = torch.where(sound, self._energy + power(sim) * self._step, self._energy)
        moved = torch.linalg.vector_norm(sim.board_pos[:, :2] - self._board, dim=-1)
        self._displacement = torch.where(sound, moved, self._displacement)
        if self._steps > self._first_counted:
            self._feet = self._feet + episode.on_deck.sum(-1)
        new = done & running
        early = outcome.termination_flags.to(torch.int8).argmax(0) + 1
        self._end = torch.where(new, torch.where(outcome.terminated, early, 0), self._end)
        self._duration = torch.where(new, episode.step * self._step, self._duration)
        self._success = torch.where(new, outcome.succeeded, self._success)
        known = new & outcome.succeeded & episode.first_contact.isfinite()
        self._mount_time = torch.where(known, success.time_to_mount(episode, self._step), self._mount_time)

    def records(self, first: int) -> EpisodeRecords:
        """Return the records of the episodes; call when all have ended.

        Args:
            first: Number of the first world's episode; the others follow in order.
        """
        n = len(self._end)
        return EpisodeRecords(
            number=torch.arange(first, first + n),
            variant=torch.zeros(n, dtype=torch.int64),
            start=self._start.cpu(),
            board_fixed=self._fixed.cpu(),
            success=self._success.cpu(),
            end=self._end.cpu(),
            duration=self._duration.cpu(),
            mount_time=self._mount_time.cpu(),
            feet=torch.where(self._end == 0, self._feet / self._last, 0.0).cpu(),
            displacement=self._displacement.cpu(),
            slips=self._slips.cpu(),
            energy=self._energy.cpu(),
        )
