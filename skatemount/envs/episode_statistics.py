"""Means over ended episodes: sums stay on the device and are read once per iteration."""

from __future__ import annotations

import torch
from torch import Tensor

from skatemount.envs.mdp import Mdp, StepResult
from skatemount.envs.state import EpisodeState
from skatemount.envs.tasks.definition import described
from skatemount.utils.errors import ConfigError

SUMS = ("episodes", "successes", "length", "time_outs")
"""Names of the sums over ended episodes; those of the task's own values follow."""


class EpisodeStatistics:
    """Means over the episodes that ended since the last `pop`, under the field's metric names.

    Args:
        mdp: The task's dynamics, for the names of its terms.
        num_worlds: Number of worlds.
    """

    def __init__(self, mdp: Mdp, num_worlds: int):
        self._context = mdp.context
        self._seconds = mdp.context.episode_steps * mdp.context.control_step
        self._values = {each.name: each.training for each in mdp.definition.metrics if each.training is not None}
        self._rewards, self._terminations = mdp.rewards.names, mdp.termination_names()
        self._n, self._device = num_worlds, mdp.device
        self.clear()

    def clear(self) -> None:
        """Reset all sums, those of the running episodes included."""
        with self._device:
            self._returns = torch.zeros(len(self._rewards), self._n)
            self._running = {name: torch.zeros(self._n) for name, each in self._values.items() if each.over == "steps"}
            self._steps = torch.zeros(self._n)
            self._counted = torch.ones(self._n, dtype=torch.bool)
        self._clear_sums()

    def restart(self, mask: Tensor) -> None:
        """Start new episodes in some worlds, whether their last ones had ended or not.

        Args:
            mask: ``[N]`` bool, the worlds that are reset.
        """
        self._returns.masked_fill_(mask, 0.0)
        for total in self._running.values():
            total.masked_fill_(mask, 0.0)
        self._steps.masked_fill_(mask, 0.0)
        self._counted |= mask

    def exclude_running(self) -> None:
        """Leave the running episodes out of the means, because they did not begin at a start state."""
        self._counted[:] = False

    def _clear_sums(self) -> None:
        with self._device:
            self._sums = torch.zeros(len(SUMS) + len(self._values), dtype=torch.float64)
            self._return_sums = torch.zeros(len(self._rewards))
            self._termination_counts = torch.zeros(len(self._terminations))

    def add(self, episode: EpisodeState, outcome: StepResult, done: Tensor) -> None:
        """Add a control step.

        Args:
            episode: The episodes after the step.
            outcome: The result of the step.
            done: ``[N]`` bool, episodes that ended in the step.
        """
        self._returns += outcome.reward_terms
        self._steps += 1.0
        counted = done & self._counted
        ended = counted.to(torch.float32)
        succeeded = (outcome.succeeded & counted).to(torch.float32)
        values = [ended, succeeded, episode.step * ended, outcome.truncated * ended]
        for name, each in self._values.items():
            value = each.function(episode, self._context)
            if value.shape != done.shape:
                found, expected = described(value), list(done.shape)
                raise ConfigError(f"metric {name!r}: training returned {found}; it must return {expected}")
            if each.over == "steps":
                self._running[name] += value
                values.append(self._running[name] * ended / self._steps)
            else:
                here = counted & outcome.succeeded if each.over == "success" else counted
                # A world whose physics failed may hold a value that is not finite.
                values.append(torch.where(here & value.isfinite(), value, 0.0))
        self._sums += torch.stack(values).sum(1)
        self._return_sums += self._returns @ ended
        self._termination_counts += outcome.termination_flags.to(torch.float32) @ ended
        self.restart(done)

    def not_finite(self) -> list[str]:
        """Return the names of the reward terms that gave a value that is not finite since the last `pop`."""
        # A sum stays not finite, also with the weight 0 of an episode that has not ended.
        finite = (self._returns.isfinite().all(1) & self._return_sums.isfinite()).tolist()
        return [name for name, good in zip(self._rewards, finite) if not good]

    def sums(self) -> list[Tensor]:
        """Return the sums over the episodes that ended since the last `pop`, which several ranks add up in place."""
        return [self._sums, self._return_sums, self._termination_counts]

    def pop(self) -> dict[str, float]:
        """Return the means since the last call, and start new sums.

        Returns:
            Means by metric name; empty if no episode ended.
        """
        sums = dict(zip((*SUMS, *self._values), self._sums.tolist()))
        n = sums["episodes"]
        if not n:
            return {}
        returns = self._return_sums / n
        metrics = {
            "Train/mean_reward": float(returns.sum()),
            "Train/mean_episode_length": sums["length"] / n,
            "Success/rate": sums["successes"] / n,
        }
        for name, each in self._values.items():
            if count := sums["successes"] if each.over == "success" else n:
                metrics[f"Success/{name}"] = sums[name] / count
        for name, value in zip(self._rewards, returns.tolist()):
            metrics[f"Episode_Reward/{name}"] = value / self._seconds
        for name, value in zip(self._terminations, (self._termination_counts / n).tolist()):
            metrics[f"Episode_Termination/{name}"] = value
        metrics["Episode_Termination/time_out"] = sums["time_outs"] / n
        self._clear_sums()
        return metrics

    def state_dict(self) -> dict[str, Tensor]:
        """Return copies of all sums, those of the running episodes included."""
        return {name: values.clone() for name, values in self._tensors().items()}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restore what `state_dict` returned."""
        for name, values in self._tensors().items():
            values.copy_(state[name])

    def _tensors(self) -> dict[str, Tensor]:
        sums = {name: values for name, values in vars(self).items() if isinstance(values, Tensor)}
        return sums | {f"running.{name}": values for name, values in self._running.items()}
