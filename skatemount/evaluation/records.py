"""Records of evaluated episodes, and the tracker that makes them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from skatemount.envs.mdp import StepResult
from skatemount.envs.mount_env import MountEnv
from skatemount.envs.state import EpisodeState
from skatemount.envs.tasks.definition import checked_value


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
        metrics: ``[N]`` values by the name of the metric, those of the task (`skatemount.envs.tasks`).
    """

    number: Tensor
    variant: Tensor
    start: Tensor
    board_fixed: Tensor
    success: Tensor
    end: Tensor
    duration: Tensor
    metrics: dict[str, Tensor] = field(default_factory=dict)

    def __getitem__(self, rows: Tensor | slice) -> EpisodeRecords:
        """Return the records of some episodes."""
        return _columnwise([self], lambda columns: columns[0][rows])

    def __len__(self) -> int:
        return len(self.number)

    @staticmethod
    def cat(parts: Sequence[EpisodeRecords]) -> EpisodeRecords:
        """Concatenate records of the same task."""
        return _columnwise(parts, torch.cat)


def _columnwise(parts: Sequence[EpisodeRecords], make: Callable[[list[Tensor]], Tensor]) -> EpisodeRecords:
    """Return records of which each column is made from that column of all parts."""
    names = [name for name in vars(parts[0]) if name != "metrics"]
    columns = {name: make([getattr(part, name) for part in parts]) for name in names}
    metrics = {name: make([part.metrics[name] for part in parts]) for name in parts[0].metrics}
    return EpisodeRecords(**columns, metrics=metrics)


class EpisodeTracker:
    """Measures one episode of every world of an environment.

    It is a listener of the environment, because what a step returns holds no physical state. Worlds whose episode has
    ended are still stepped; the tracker ignores them.

    Args:
        env: The environment.
    """

    def __init__(self, env: MountEnv):
        self._env = env
        self._task = env.mdp.definition
        self._context = env.mdp.context

    def begin(self) -> None:
        """Begin new episodes; call after the environment's reset."""
        env, n = self._env, self._env.num_worlds
        self._start, self._fixed = env.episode.start.clone(), env.sim.board_fixed.clone()
        self._measures = {
            metric.name: metric.start(env.sim, env.episode, self._context) for metric in self._task.metrics
        }
        self._values: dict[str, Tensor] = {}
        with self._start.device:
            self._end, self._duration = torch.full((n,), -1), torch.zeros(n)
            self._success = torch.zeros(n, dtype=torch.bool)

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
        running = self._end < 0
        # The last row is true where physics failed: the state of such a world means nothing.
        sound = running & ~outcome.termination_flags[-1]
        for metric in self._task.metrics:
            value = self._measures[metric.name](sim, episode, self._context)
            value = checked_value(value, metric, self._task.name, episode)
            before = self._values.get(metric.name, torch.zeros_like(value))
            self._values[metric.name] = torch.where(sound, value, before)
        new = done & running
        early = outcome.termination_flags.to(torch.int8).argmax(0) + 1
        self._end = torch.where(new, torch.where(outcome.terminated, early, 0), self._end)
        self._duration = torch.where(new, episode.step * self._context.control_step, self._duration)
        self._success = torch.where(new, outcome.succeeded, self._success)

    def records(self, first: int) -> EpisodeRecords:
        """Return the records of the episodes; call when all have ended.

        Args:
            first: Number of the first world's episode; the others follow in order.
        """
        n = len(self._end)
        counted = {"complete": self._end == 0, "success": self._success}
        metrics = {
            metric.name: (
                self._values[metric.name]
                if metric.counts == "all"
                else torch.where(counted[metric.counts], self._values[metric.name], metric.otherwise)
            ).cpu()
            for metric in self._task.metrics
        }
        return EpisodeRecords(
            number=torch.arange(first, first + n),
            variant=torch.zeros(n, dtype=torch.int64),
            start=self._start.cpu(),
            board_fixed=self._fixed.cpu(),
            success=self._success.cpu(),
            end=self._end.cpu(),
            duration=self._duration.cpu(),
            metrics=metrics,
        )
