"""Count the episodes that succeed in only one of `skatemount.runner` and `skatemount.evaluate`.

    python -m skatemount.export checkpoint=pretrained:anywhere output=my_policy
    python benchmarks/runner_pairs.py my_policy pretrained:anywhere --suites mount-unfixed pushed
    python benchmarks/runner_pairs.py my_policy pretrained:anywhere --suites mount-unfixed pushed --same-noise

Both programs run the episodes whose start states are in the folder, so each episode is a pair: one result in plain
MuJoCo, one with torch. The script ends with an error if the two starts of a pair differ.

Printed are, for each suite and for all together, the success of both with 95 % intervals, the numbers of pairs by their
results, and the p-value of McNemar's exact test: if both programs were equal, a pair that succeeds in only one of them
would be of either kind with probability 1/2. ``other end`` is the number of pairs that end by another cause or in
another control step.

Each program draws the noise of sensors and observation itself, as it does alone. With ``--same-noise`` the runner gets
the noise that `evaluate` drew.
"""

from __future__ import annotations

import argparse
import itertools
import math
import sys
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from torch import Generator, Tensor

from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.envs import sensing
from skatemount.envs.observations import table
from skatemount.evaluation.intervals import wilson_interval
from skatemount.evaluation.suite_task import EvaluationTask, load_suite
from skatemount.runner.bench import run_suite
from skatemount.runner.controller import Controller
from skatemount.runner.folder import PolicyFolder
from skatemount.runner.simulation import SimulatedWorld, run_episode

HEADER = ("suite", "runner", "evaluate", "both", "only runner", "only evaluate", "neither", "other end", "p")


@dataclass(frozen=True)
class Result:
    """Result of an episode in one of the programs.

    Attributes:
        success: True if it succeeded.
        ended_by: The termination that ended it, or the task's failure at the time limit.
        duration: Its length, s.
        start: Initial x, y (m) and yaw (rad) of the trunk in the board's frame.
    """

    success: bool
    ended_by: str
    duration: float
    start: tuple[float, ...]


@dataclass(frozen=True)
class Pairs:
    """Numbers of pairs of episodes by their results.

    Attributes:
        both: Both succeeded.
        runner: Only the runner's did.
        evaluate: Only that of `evaluate` did.
        neither: Both failed.
        other_end: They end by another cause or in another control step.
    """

    both: int = 0
    runner: int = 0
    evaluate: int = 0
    neither: int = 0
    other_end: int = 0

    @classmethod
    def of(cls, runner: Sequence[Result], evaluate: Sequence[Result]) -> Pairs:
        """Count pairs.

        Args:
            runner: Results of the episodes in their order.
            evaluate: Results of the same episodes.

        Raises:
            ValueError: A pair does not have the same start.
        """
        counts, other_end = {(True, True): 0, (True, False): 0, (False, True): 0, (False, False): 0}, 0
        for number, (one, other) in enumerate(zip(runner, evaluate, strict=True)):
            # The runner rounds to four digits.
            if not np.allclose(one.start, other.start, rtol=0, atol=1e-4):
                raise ValueError(f"episode {number} starts at {one.start} and at {other.start}")
            counts[one.success, other.success] += 1
            other_end += one.ended_by != other.ended_by or abs(one.duration - other.duration) > 1e-3
        return cls(*counts.values(), other_end)

    def __add__(self, other: Pairs) -> Pairs:
        return Pairs(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))

    @property
    def p_value(self) -> float:
        """P-value of McNemar's exact test, two-sided."""
        n, fewer = self.runner + self.evaluate, min(self.runner, self.evaluate)
        return min(1.0, 2 * sum(math.comb(n, k) for k in range(fewer + 1)) / 2**n)

    def row(self, name: str) -> str:
        """Return a row of the table."""
        counts = astuple(self)
        episodes, cells = sum(counts[:4]), [name]
        for successes in (self.both + self.runner, self.both + self.evaluate):
            low, high = (100 * end for end in wilson_interval(successes, episodes))
            cells.append(f"{100 * successes / episodes:.1f} % ({low:.1f} to {high:.1f} %)")
        return f"| {' | '.join([*cells, *map(str, counts), f'{self.p_value:.2g}'])} |"


class Drawn:
    """Keeps what a module draws with `coarse_noise`, for a ``with`` block.

    Args:
        module: The module.

    Attributes:
        steps: What was drawn, ``[N, K]`` in each control step; the first ones are of the start.
    """

    def __init__(self, module: Any):
        self._module, self._draw = module, module.coarse_noise
        self.steps: list[np.ndarray] = []

    def __enter__(self) -> Drawn:
        self._module.coarse_noise = self
        return self

    def __exit__(self, *error: object) -> None:
        self._module.coarse_noise = self._draw

    def __call__(self, shape: Sequence[int], generator: Generator) -> Tensor:
        """Draw, and keep a copy."""
        values: Tensor = self._draw(shape, generator)
        self.steps.append(values.numpy().copy())
        return values


class SameNoise:
    """Stands in for the random numbers of an episode in the runner, which draws what `evaluate` drew.

    Args:
        observed: Noise of the observation, the first one of the start; empty without any.
        errors: Errors of the sensors in the same manner.
        row: The episode's world.
    """

    def __init__(self, observed: list[np.ndarray], errors: list[np.ndarray], row: int):
        # The errors of the start are part of the start state.
        drawn = [part for part in (observed, errors[1:]) if part]
        self._left, self._row = itertools.chain.from_iterable(zip(*drawn)), row

    def uniform(self, low: float, high: float, size: int) -> np.ndarray:
        """Return the noise of the observation and the errors of the sensors in turn, as far as there are any."""
        values = next(self._left)[self._row]
        assert values.shape == (size,)
        return np.asarray(values)


def evaluated(
    task: EvaluationTask, folder: PolicyFolder, part: dict[str, Any], episodes: int, same_noise: bool
) -> tuple[list[Result], list[Result]]:
    """Run episodes with torch, and in the runner if it shall have the same noise.

    Args:
        task: The suite.
        folder: The exported policy.
        part: The suite's part of the card.
        episodes: Number of episodes.
        same_noise: Whether to run them in the runner, too.

    Returns:
        The results of `evaluate`, and those of the runner or none.
    """
    turns, of_runner, of_torch = len(part["variants"]), {}, {}
    for index, variant in enumerate(part["variants"]):
        evaluator = task.evaluator(variant["name"])
        count, worlds = len(range(index, episodes, turns)), evaluator.env.num_worlds
        world, controller = SimulatedWorld(folder, variant), Controller(folder, variant["observe"])
        step, names = evaluator.env.mdp.context.control_step, evaluator.end_names
        try:
            for first in range(0, count, worlds):
                with Drawn(table) as observed, Drawn(sensing) as errors:
                    records = evaluator.round(task.agent.policy, first // worlds)
                columns = (records.success, records.end, records.duration, records.start)
                rows = list(zip(*(column.tolist() for column in columns), strict=True))[: count - first]
                for row, (success, end, duration, start) in enumerate(rows):
                    number = (first + row) * turns + index
                    of_torch[number] = Result(success, names[end], duration, tuple(start))
                    if same_noise:
                        drawn = (observed.steps, controller.noise_size), (errors.steps, world.error_size)
                        noise: Any = SameNoise(*(steps if size else [] for steps, size in drawn), row)
                        done = run_episode(controller, world, variant, first + row, noise)
                        begun = tuple(world.starts["start"][first + row].tolist())
                        of_runner[number] = Result(done[0], done[1], done[2] * step, begun)
        finally:
            evaluator.close()
    return [of_torch[i] for i in sorted(of_torch)], [of_runner[i] for i in sorted(of_runner)]


def compare(
    folder: PolicyFolder,
    agent: TrainedPolicy,
    suite: str,
    episodes: int | None = None,
    machine: Sequence[str] = (),
    same_noise: bool = False,
) -> Pairs:
    """Run the episodes of a suite in both programs.

    Args:
        folder: The exported policy.
        agent: The policy that was exported.
        suite: Name of the suite.
        episodes: Number of episodes; all start states of the folder if None.
        machine: Settings of the machine.
        same_noise: Whether the runner gets the noise that `evaluate` drew.
    """
    part = folder.suites[suite]
    count = episodes or part["episodes"]
    task = EvaluationTask.of(agent, load_suite(suite), [*part["changed_by"], *machine], part["seed"])
    of_torch, of_runner = evaluated(task, folder, part, count, same_noise)
    if not same_noise:
        found = run_suite(folder, suite, count)
        of_runner = [Result(each.success, each.ended_by, each.duration, each.start) for each in found]
    return Pairs.of(of_runner, of_torch)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", help="an exported policy")
    parser.add_argument("policy", help="the policy that was exported: a run, a checkpoint, or pretrained:NAME")
    parser.add_argument("--suites", nargs="+", help="suites of the folder (default all)")
    parser.add_argument("--episodes", type=int, help="episodes of each suite (default all start states)")
    parser.add_argument("--same-noise", action="store_true", help="give the runner the noise of evaluate")
    parser.add_argument("--settings", nargs="+", default=[], help="of the machine, such as physics.threads=1")
    options = parser.parse_args()
    folder, agent = PolicyFolder(Path(options.folder)), TrainedPolicy.load(options.policy)
    if folder.card["policy"]["weights_sha256"] != agent.card.sha256:
        sys.exit(f"{options.folder} is not an export of {options.policy}")
    print(f"| {' | '.join(HEADER)} |", "|---" * len(HEADER) + "|", sep="\n", flush=True)
    total = Pairs()
    for suite in options.suites or folder.suites:
        pairs = compare(folder, agent, suite, options.episodes, options.settings, options.same_noise)
        total += pairs
        print(pairs.row(f"`{suite}`"), flush=True)
    print(total.row("all"))


if __name__ == "__main__":
    main()
