"""Measurements of an episode, from which tasks make their metrics.

A measurement that needs the present state alone is a function ``(sim, episode, context)`` that returns ``[N]``, as a
term is. A measurement with memory is a subclass of `Measure`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable

import torch
from torch import Tensor

from skatemount.envs.config.task import HOLD
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.terms import TaskContext

SLIP_SPEED = 0.25
"""Speed of a pressing foot along the deck that counts as a slip, m/s."""

MeasureFunction = Callable[[SimState, EpisodeState, TaskContext], Tensor]
"""A function of the state after a step, the episodes and the constants of the task that returns ``[N]``."""


class Measure(ABC):
    """A measurement with memory, of one episode of each of N worlds.

    The value of an episode is what the measurement returned in the episode's last step. A world in which physics failed
    keeps the value of the step before.
    """

    @abstractmethod
    def begin(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> None:
        """Begin new episodes in every world.

        Args:
            sim: ``[N]`` start states.
            episode: ``[N]`` episodes at their start.
            context: Constants of the task.
        """

    @abstractmethod
    def __call__(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
        """Add a control step, and return the value of each episode if it ended now, ``[N]``.

        Args:
            sim: The state after the step. Copy what you keep.
            episode: The episodes after the step.
            context: Constants of the task.
        """


def integral(rate: MeasureFunction) -> type[Measure]:
    """Return a measurement that adds up a rate over time: the sum of ``rate * control_step`` over the steps.

    Args:
        rate: The rate, per second.
    """

    class Integral(Measure):
        """Sum of a rate over time."""

        def begin(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> None:
            """Begin new episodes at 0."""
            self._total = torch.zeros(episode.step.shape, device=episode.step.device)

        def __call__(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
            """Add the rate of this step."""
            self._total = self._total + rate(sim, episode, context) * context.control_step
            return self._total

    return Integral


def sliding(sim: SimState, on_deck: Tensor) -> Tensor:
    """Return the feet that slide on the deck, ``[N, F]`` bool.

    A foot slides if it presses on the deck and its center moves along the deck's plane, relative to the board, faster
    than 0.25 m/s.

    Args:
        sim: The state.
        on_deck: ``[N, F]`` bool, feet that press on the deck.
    """
    return on_deck & (torch.linalg.vector_norm(sim.foot_vel_board[..., :2], dim=-1) > SLIP_SPEED)


def power(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the mechanical power of the joints, ``sum(|torque * velocity|)``, ``[N]``, W.

    Absolute values, because a motor that brakes does not give energy back.
    """
    return (sim.joint_torque * sim.joint_vel).abs().sum(-1)


class Slips(Measure):
    """Number of slips, ``[N]`` int64.

    A slip is a control step in which a foot slides (`sliding`) and did not slide in the step before. One long slide
    counts once, and so does a foot that slides as it lands.
    """

    def begin(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> None:
        """Begin new episodes, in which no foot slides."""
        self._sliding = torch.zeros_like(episode.on_deck)
        self._count = torch.zeros_like(episode.step)

    def __call__(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
        """Count the slips that begin in this step."""
        slides = sliding(sim, episode.on_deck)
        self._count = self._count + (slides & ~self._sliding).sum(-1)
        self._sliding = slides
        return self._count


class BoardDisplacement(Measure):
    """Horizontal distance of the deck's center from its place at the start, ``[N]`` m."""

    def begin(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> None:
        """Note the deck's center."""
        self._start = sim.board_pos[:, :2].clone()

    def __call__(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
        """Return the present distance."""
        return torch.linalg.vector_norm(sim.board_pos[:, :2] - self._start, dim=-1)


class FeetOnBoard(Measure):
    """Mean number of feet on the deck in the last second before the time limit, ``[N]``."""

    def begin(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> None:
        """Begin new episodes without any feet."""
        self._steps = min(context.episode_steps, max(1, round(HOLD / context.control_step)))
        self._feet = torch.zeros(episode.step.shape, device=episode.step.device)

    def __call__(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
        """Add this step if it is one of the last second."""
        counts = episode.step > context.episode_steps - self._steps
        self._feet = torch.where(counts, self._feet + episode.on_deck.sum(-1), self._feet)
        return self._feet / self._steps


def feet_now(episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the number of feet that press on the deck now, ``[N]``."""
    return episode.on_deck.sum(-1)


def is_mounted(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the worlds in which the robot is mounted now (`skatemount.envs.success.is_mounted`), ``[N]`` bool."""
    return episode.mounted


def board_speed(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the horizontal speed of the deck's center, ``[N]`` m/s."""
    return torch.linalg.vector_norm(sim.board_lin_vel[:, :2], dim=-1)
