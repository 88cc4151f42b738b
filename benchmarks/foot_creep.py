"""Measure how far the feet of a robot that stands on the board creep, and how often it steps off again.

    python benchmarks/foot_creep.py pretrained:robust --suites drawn-boards mount-unfixed rolling

Printed for each suite, over one round of at most 256 episodes:

* success;
* creep: mean speed of the feet relative to the board while the robot is mounted, mm/s;
* sideways: mean force of a foot along the deck in the same steps, N;
* stepped off: share of the failed episodes in which the robot had been mounted for a whole second before. It stood
  well, and then put a foot elsewhere.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import torch

from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.envs import MountEnv
from skatemount.evaluation.suite_task import EvaluationTask, load_suite


@dataclass
class Stance:
    """Success, and the movements of the feet, in one round of episodes.

    Attributes:
        successes: Number of successful episodes.
        episodes: Number of episodes.
        creep: Mean speed of the feet on the board while mounted, m/s.
        sideways: Mean force of a foot along the deck in these steps, N.
        stood: Number of failed episodes with a mounted second.
    """

    successes: int
    episodes: int
    creep: float
    sideways: float
    stood: int


def measure(agent: TrainedPolicy, suite: str, settings: list[str]) -> Stance:
    """Run a round of a suite's episodes, and measure the feet.

    Args:
        agent: The policy.
        suite: Name of the suite, whose first variant counts.
        settings: Changes of the suite's settings.
    """
    task = EvaluationTask.of(agent, load_suite(suite), settings)
    evaluator = task.evaluator(next(iter(task.configs)))
    env: MountEnv = evaluator.env
    speeds, forces, longest = [], [], torch.zeros(env.num_worlds)

    def watch(step: int) -> None:
        sim, episode = env.sim, env.episode
        torch.maximum(longest, episode.mounted_time, out=longest)
        speeds.append(sim.foot_vel_board[episode.mounted][..., :2].norm(dim=-1).flatten())
        forces.append(sim.foot_deck_force[episode.mounted][..., :2].norm(dim=-1).flatten())

    try:
        result = evaluator.round(agent.policy, 0, watch)
    finally:
        evaluator.close()
    failed = ~result.success
    return Stance(
        successes=int(result.success.sum()),
        episodes=len(failed),
        creep=float(torch.cat(speeds).mean()),
        sideways=float(torch.cat(forces).mean()),
        stood=int((failed & (longest >= 1.0)).sum()),
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("policies", nargs="+", help="runs, checkpoints, or pretrained:NAME")
    parser.add_argument("--suites", nargs="+", default=["drawn-boards", "mount-unfixed", "rolling"])
    parser.add_argument("--settings", nargs="+", default=[], help="such as physics.foot_impedance=[0.9,0.95]")
    options = parser.parse_args()
    names = ["policy", "suite", "success", "creep, mm/s", "sideways, N", "failures", "stepped off"]
    print(f"| {' | '.join(names)} |", "|---" * len(names) + "|", sep="\n")
    for policy in options.policies:
        agent = TrainedPolicy.load(policy)
        for suite in options.suites:
            found = measure(agent, suite, options.settings)
            failures = found.episodes - found.successes
            off = f"{100 * found.stood / failures:.0f} %" if failures else "–"
            print(
                f"| {agent.name} | {suite} | {100 * found.successes / found.episodes:.1f} % | {1000 * found.creep:.1f} "
                f"| {found.sideways:.1f} | {failures} | {off} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
