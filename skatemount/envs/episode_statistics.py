"""What happened in the episodes that ended: sums kept on the device, read once an iteration."""

from __future__ import annotations

import torch
from torch import Tensor

from skatemount.envs import success
from skatemount.envs.mdp import Mdp, StepResult
from skatemount.envs.state import EpisodeState

SUMS = ("episodes", "successes", "length", "feet", "mount_time", "time_outs")
"""What is added up over the episodes that ended: how many, how many succeeded, and so on."""


class EpisodeStatistics:
    """Means over the episodes that ended since the last `pop`, under the field's metric names.

    Args:
        mdp: The task's mathematics, for the names of its terms.
        num_worlds: Number of worlds.
    """

    def __init__(self, mdp: Mdp, num_worlds: int):
        self._step = mdp.context.control_step
        self._seconds = mdp.context.episode_steps * self._step
        self._mounts = mdp.criterion == "mount"
        self._rewards, self._ends = mdp.rewards.names, mdp.end_names()
        self._n, self._device = num_worlds, mdp.device
        self.clear()

    def clear(self) -> None:
        """Forget everything, the running episodes' returns included."""
        with self._device:
            self._returns = torch.zeros(len(self._rewards), self._n)
            self._feet = torch.zeros(self._n)
            self._steps = torch.zeros(self._n)
            self._counted = torch.ones(self._n, dtype=torch.bool)
        self._forget()

    def restart(self, mask: Tensor) -> None:
        """Forget the running episodes of some worlds.

        Args:
            mask: ``[N]`` bool, worlds that start anew, whether their episodes had ended or not.
        """
        self._returns.masked_fill_(mask, 0.0)
        self._feet.masked_fill_(mask, 0.0)
        self._steps.masked_fill_(mask, 0.0)
        self._counted |= mask

    def leave_out(self) -> None:
        """Do not count the episodes that are running: they began in the middle."""
        self._counted[:] = False

    def _forget(self) -> None:
        with self._device:
            self._sums = torch.zeros(len(SUMS), dtype=torch.float64)
            self._shares = torch.zeros(len(self._rewards))
            self._end_counts = torch.zeros(len(self._ends))

    def add(self, episode: EpisodeState, outcome: StepResult, done: Tensor) -> None:
        """Account for a step.

        Args:
            episode: The episodes after the step.
            outcome: What it led to.
            done: ``[N]`` bool, episodes that ended.
        """
        self._returns += outcome.reward_terms
        self._feet += episode.on_deck.sum(-1)
        self._steps += 1.0
        counted = done & self._counted
        ended = counted.to(torch.float32)
        succeeded = (outcome.succeeded & counted).to(torch.float32)
        times = torch.where(outcome.succeeded, success.time_to_mount(episode, self._step), 0.0)
        values = (
            ended,
            succeeded,
            episode.step * ended,
            self._feet * ended / self._steps,
            times * succeeded,
            outcome.truncated * ended,
        )
        self._sums += torch.stack(values).sum(1)
        self._shares += self._returns @ ended
        self._end_counts += outcome.termination_flags.to(torch.float32) @ ended
        self.restart(done)

    def pop(self) -> dict[str, float]:
        """Means since the last call; nothing if no episode ended."""
        sums = dict(zip(SUMS, self._sums.tolist()))
        n = sums["episodes"]
        if not n:
            return {}
        shares = self._shares / n
        metrics = {
            "Train/mean_reward": float(shares.sum()),
            "Train/mean_episode_length": sums["length"] / n,
            "Success/rate": sums["successes"] / n,
            "Success/feet_on_board": sums["feet"] / n,
        }
        if sums["successes"] and self._mounts:
            metrics["Success/time_to_mount"] = sums["mount_time"] / sums["successes"]
        for name, value in zip(self._rewards, shares.tolist()):
            metrics[f"Episode_Reward/{name}"] = value / self._seconds
        for name, value in zip(self._ends, (self._end_counts / n).tolist()):
            metrics[f"Episode_Termination/{name}"] = value
        metrics["Episode_Termination/time_out"] = sums["time_outs"] / n
        self._forget()
        return metrics
