"""Evaluation of a policy: whole episodes, deterministic actions, seeds that training does not use."""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import torch
from rich import box
from rich.console import Console
from rich.table import Table
from torch import Tensor
from torchrl.envs.utils import ExplorationType, set_exploration_type

from skatemount.benchmark.statistics import wilson_interval
from skatemount.config import Config
from skatemount.envs import success
from skatemount.envs.mount_env import MountEnv
from skatemount.envs.task import MountTask
from skatemount.errors import ConfigError
from skatemount.models import ActorCritic

EVALUATION_SEED = 1_000_003
"""Added to ``seed`` in evaluations and films, so that they never repeat a training's start states."""

NUM_WORLDS = 256
"""Worlds stepped together where nobody asks for another number. It is no setting of the machine's,
because the worlds that are drawn depend on it."""

TIME_OUT = "time_out"


@dataclass
class Evaluation:
    """What came of the evaluated episodes.

    Attributes:
        episodes: How many.
        successes: How many of them succeeded.
        feet_on_board: Mean over all episodes of the mean number of feet on the deck during the
            episode's last second, 0 to 4; an episode that ended early counts 0.
        times_to_mount: Seconds from the first contact with the deck to standing on it, of every
            episode that succeeded (empty where there is nothing to mount).
        ended: Share of the episodes by what ended them: `time_out` or the first of the terminations,
            in the table's order, that was true. The shares add up to 1.
        evaluated: What was evaluated, and how.
    """

    episodes: int
    successes: int
    feet_on_board: float
    times_to_mount: list[float] = field(default_factory=list)
    ended: dict[str, float] = field(default_factory=dict)
    evaluated: dict[str, Any] = field(default_factory=dict)

    @property
    def success_rate(self) -> float:
        """Share of the episodes that succeeded."""
        return self.successes / self.episodes

    def time_to_mount(self, quantile: float) -> float | None:
        """A quantile of the times to mount, seconds; none if nothing was mounted."""
        if not self.times_to_mount:
            return None
        times = torch.tensor(self.times_to_mount, dtype=torch.float64)
        return round(float(times.quantile(quantile)), 4)

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain values for JSON; the interval is Wilson's with 95 % confidence."""
        low, high = wilson_interval(self.successes, self.episodes)
        return {
            "episodes": self.episodes,
            "success": {"rate": self.success_rate, "low": low, "high": high},
            "feet_on_board": self.feet_on_board,
            "time_to_mount": {
                "median": self.time_to_mount(0.5),
                "p95": self.time_to_mount(0.95),
            },
            "ended": dict(self.ended),
            "evaluated": dict(self.evaluated),
        }

    def metrics(self) -> dict[str, float]:
        """The results under the names that training logs them by."""
        metrics = {
            "Evaluation/success": self.success_rate,
            "Evaluation/feet_on_board": self.feet_on_board,
        }
        median = self.time_to_mount(0.5)
        if median is not None:
            metrics["Evaluation/time_to_mount"] = median
        return metrics

    def table(self) -> str:
        """The results for a terminal, several lines."""
        low, high = wilson_interval(self.successes, self.episodes)
        median, p95 = self.time_to_mount(0.5), self.time_to_mount(0.95)
        shares = sorted(self.ended.items(), key=lambda item: -item[1])
        rows = {
            "episodes": str(self.episodes),
            "success": f"{self.success_rate:.1%} (95 % interval {low:.1%} to {high:.1%})",
            "feet on board": f"{self.feet_on_board:.2f} of 4 in the last second",
            "time to mount": "-" if median is None else f"median {median:.2f} s, 95 % within {p95:.2f} s",
            "ended by": ", ".join(f"{n.replace('_', ' ')} {share:.1%}" for n, share in shares if share),
        }
        what = [str(self.evaluated[key]) for key in ("checkpoint", "suite") if key in self.evaluated]
        table = Table(" on ".join(what) or "evaluation", "", box=box.SIMPLE_HEAD, pad_edge=False)
        for name, value in rows.items():
            table.add_row(name, value)
        console = Console()
        with console.capture() as captured:
            console.print(table)
        return captured.get().strip("\n")


class Evaluator:
    """Evaluates policies in an environment that is built once.

    Each world runs one whole episode a round, and a round lasts until the time limit whatever
    happened: worlds that start anew as soon as they are done would count short episodes, which are
    mostly failures, more often. Every run begins anew from the seed, so equal weights give equal
    numbers, and different weights meet the same worlds and start states.

    Args:
        config: Task to evaluate in, its noise and randomisation included.
        num_worlds: Worlds stepped together.
        seed: Source of worlds, start states and noise.

    Attributes:
        env: The environment.
    """

    def __init__(self, config: Config, num_worlds: int | None = None, seed: int = EVALUATION_SEED) -> None:
        self.config = config
        self.seed = seed
        self.env = MountEnv(MountTask(config=config), num_worlds=num_worlds, seed=seed)

    def run(
        self,
        networks: ActorCritic,
        episodes: int,
        progress: Callable[[int, int], None] | None = None,
    ) -> Evaluation:
        """Evaluate a policy with deterministic actions.

        Args:
            networks: The policy; its weights stay as they are.
            episodes: How many to count; of the last round the first worlds are.
            progress: Called with the control steps done and to do.

        Returns:
            The results.

        Raises:
            ConfigError: Fewer than 1 episode.
        """
        if episodes < 1:
            raise ConfigError(f"episodes={episodes} must be at least 1")
        env, steps = self.env, self.env.mdp.context.episode_steps
        env.set_seed(self.seed)
        rounds = math.ceil(episodes / env.num_worlds)
        stepped = itertools.count(1)

        def report() -> None:
            if progress is not None:
                progress(next(stepped), rounds * steps)

        with deterministic():
            records = [self._round(networks, report) for _ in range(rounds)]
        env.statistics.clear()
        return self._summarise(_Records.cat(records, episodes))

    def close(self) -> None:
        """Free the environment."""
        self.env.close()

    def _round(self, networks: ActorCritic, report: Callable[[], None]) -> _Records:
        """One episode of every world."""
        env = self.env
        context = env.mdp.context
        steps = context.episode_steps
        last = min(steps, max(1, round(success.HOLD / context.control_step)))
        records = _Records.empty(env.num_worlds)
        feet = torch.zeros(env.num_worlds)
        seen = env.reset()
        for step in range(1, steps + 1):
            seen = env.step(networks.actor(seen))["next"]
            if step > steps - last:
                feet += env.episode.on_deck.sum(-1)
            new = seen["done"].squeeze(-1) & (records.end < 0)
            if new.any():
                times = success.time_to_mount(env.episode, context.control_step)
                reached = env.episode.first_contact.isfinite()
                times = torch.where(reached, times, torch.nan)
                records.set(new, seen["success"].squeeze(-1), times, first_end(env))
            report()
        # A round is as long as the longest episode, so by now each has ended.
        records.feet = torch.where(records.end == 0, feet / last, 0.0)
        return records

    def _summarise(self, records: _Records) -> Evaluation:
        n = len(records.end)
        names = [TIME_OUT, *self.env.mdp.end_names()]
        counts = torch.bincount(records.end, minlength=len(names)).tolist()
        times = records.time[records.success & records.time.isfinite()]
        physics, config = self.env.physics, self.config
        return Evaluation(
            episodes=n,
            successes=int(records.success.sum()),
            feet_on_board=float(records.feet.mean(dtype=torch.float64)),
            times_to_mount=times.tolist(),
            ended={name: count / n for name, count in zip(names, counts, strict=True)},
            evaluated={
                "seed": self.seed,
                "num_worlds": physics.num_worlds,
                "episode_length": config.episode_length,
                "control_step": self.env.mdp.context.control_step,
            },
        )


def first_end(env: MountEnv) -> Tensor:
    """What ends an episode in each world now.

    Returns:
        ``[N]`` int64: 0 for nothing but the time limit, i for the i-th of ``env.mdp.end_names()``.
    """
    rows = torch.cat((env.mdp.terminations(env.sim, env.episode), env.physics.diverged().unsqueeze(0)))
    return torch.where(rows.any(0), rows.to(torch.int8).argmax(0) + 1, 0)


def evaluate_policy(
    networks: ActorCritic,
    config: Config,
    episodes: int,
    seed: int = EVALUATION_SEED,
    num_worlds: int = NUM_WORLDS,
    progress: Callable[[int, int], None] | None = None,
) -> Evaluation:
    """Evaluate a policy once; see `Evaluator`.

    Args:
        networks: The policy.
        config: Task to evaluate in.
        episodes: How many to count.
        seed: Source of worlds, start states and noise.
        num_worlds: Worlds stepped together, at most; never more than there are episodes.
        progress: Called with the control steps done and to do.

    Returns:
        The results.
    """
    evaluator = Evaluator(config, min(num_worlds, max(episodes, 1)), seed)
    try:
        return evaluator.run(networks, episodes, progress)
    finally:
        evaluator.close()


@dataclass
class _Records:
    """The verdicts of the episodes; `end` is -1 until there is one."""

    success: Tensor
    time: Tensor
    end: Tensor
    feet: Tensor

    @classmethod
    def empty(cls, n: int) -> _Records:
        return cls(
            success=torch.zeros(n, dtype=torch.bool),
            time=torch.full((n,), torch.nan),
            end=torch.full((n,), -1),
            feet=torch.zeros(n),
        )

    def set(self, mask: Tensor, succeeded: Tensor, time: Tensor, end: Tensor) -> None:
        self.success = torch.where(mask, succeeded, self.success)
        self.time = torch.where(mask, time, self.time)
        self.end = torch.where(mask, end, self.end)

    @classmethod
    def cat(cls, parts: list[_Records], count: int) -> _Records:
        """The first ``count`` of the parts' episodes."""
        names = cls.__dataclass_fields__
        return cls(*(torch.cat([getattr(p, name) for p in parts])[:count] for name in names))


@contextlib.contextmanager
def deterministic() -> Iterator[None]:
    """Mean actions, no gradients, and exact matrix products whatever training has chosen."""
    precision = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("highest")
    try:
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            yield
    finally:
        torch.set_float32_matmul_precision(precision)
