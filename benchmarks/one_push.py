"""Measure what one push does to a robot that stands on a free board.

    python benchmarks/one_push.py pretrained:robust --rounds 8

Robots mount the board as in the suite `pushed`, but without its pushes. After three seconds, each robot that has been
mounted for at least half a second gets one push: the velocity of its trunk jumps by up to `--fastest`, along the board
or across it. The script prints a row for each direction and each range of speeds:

* robots: number of pushed robots;
* kept: share of them that stayed mounted for the next second;
* again: share of them that was mounted throughout the last second of the episode, which ends three seconds after the
  push. The suite asks for that second, and its pushes come every one to two seconds.

With `--frozen` the joint targets stay as they were before the push, so the robot does not react to it.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from tensordict import TensorDictBase
from torch import Tensor

from skatemount.agents.policy import Policy
from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.envs import MountEnv
from skatemount.evaluation.evaluator import Evaluator
from skatemount.evaluation.suite_task import EvaluationTask, load_suite

PUSH_AT = 3.0
"""Time of the push, s."""
STOOD = 0.5
"""Time for which a robot has to be mounted before it is pushed, s."""


@dataclass
class Pushes:
    """Pushed robots of all rounds, with an entry for each robot.

    Attributes:
        speed: Length of the push, m/s.
        across: Bool, the push was across the board, not along it.
        kept: Bool, mounted without a break for a second after the push.
        again: Bool, mounted throughout the last second of the episode, which is its success.
    """

    speed: list[Tensor] = field(default_factory=list)
    across: list[Tensor] = field(default_factory=list)
    kept: list[Tensor] = field(default_factory=list)
    again: list[Tensor] = field(default_factory=list)

    def rows(self, edges: list[float]) -> list[tuple[bool, float, float, int, float, float]]:
        """Return a row for each direction and range of speeds.

        Args:
            edges: Bounds of the ranges, m/s, ascending.

        Returns:
            Tuples of across, lower and upper bound, number of robots, and the shares ``kept`` and ``again``.
        """
        speed, across, kept, again = (torch.cat(each) for each in (self.speed, self.across, self.kept, self.again))
        found = []
        for direction in (False, True):
            for low, high in zip(edges, edges[1:]):
                chosen = (across == direction) & (speed >= low) & (speed < high)
                shares = [float(each[chosen].float().mean()) for each in (kept, again)]
                found.append((direction, low, high, int(chosen.sum()), *shares))
        return found


class Frozen:
    """A policy that repeats its last action from the push on.

    Args:
        policy: The policy until then.
    """

    def __init__(self, policy: Policy):
        self._policy = policy

    def actor_in(self, env: MountEnv) -> Callable[[TensorDictBase], TensorDictBase]:
        """Return a function that acts in an environment from its next reset on; see `Policy`."""
        actor, last = self._policy.actor_in(env), round(PUSH_AT / env.mdp.context.control_step)
        calls, action = 0, torch.zeros(())

        def act(state: TensorDictBase) -> TensorDictBase:
            nonlocal calls, action
            calls += 1
            if calls <= last:
                action = actor(state)["action"].clone()
            return state.set("action", action)

        return act


def measure(agent: TrainedPolicy, rounds: int, fastest: float, settings: list[str], frozen: bool = False) -> Pushes:
    """Push the robots of some rounds of episodes once.

    Args:
        agent: The policy.
        rounds: Number of rounds of at most 256 episodes.
        fastest: Longest push, m/s.
        settings: Changes of the suite's settings.
        frozen: Keep the joint targets from the push on.
    """
    quiet = ["randomization.push_velocity=[0.0,0.0]", *settings]
    task = EvaluationTask.of(agent, load_suite("pushed"), quiet)
    evaluator = task.evaluator(next(iter(task.configs)))
    policy = Frozen(agent.policy) if frozen else agent.policy
    generator, found = torch.Generator().manual_seed(0), Pushes()
    try:
        for number in range(rounds):
            _round(evaluator, policy, number, fastest, generator, found)
    finally:
        evaluator.close()
    return found


def _round(
    evaluator: Evaluator, policy: Policy, number: int, fastest: float, generator: torch.Generator, found: Pushes
) -> None:
    env: MountEnv = evaluator.env
    n, dt = env.num_worlds, env.mdp.context.control_step
    speed = fastest * torch.rand(n, generator=generator)
    across = torch.rand(n, generator=generator) < 0.5
    sign = torch.where(torch.rand(n, generator=generator) < 0.5, 1.0, -1.0)
    pushed, kept = torch.zeros(n, dtype=torch.bool), torch.zeros(n, dtype=torch.bool)

    def watch(step: int) -> None:
        if step == round(PUSH_AT / dt):
            pushed.copy_(env.episode.mounted_time >= STOOD)
            axis = torch.where(across[:, None], env.sim.board_rot[:, :, 1], env.sim.board_rot[:, :, 0])
            env.physics.push(pushed, (sign * speed)[:, None] * axis * torch.tensor([1.0, 1.0, 0.0]))
        elif step == round((PUSH_AT + 1.0) / dt):
            kept.copy_(pushed & (env.episode.mounted_time >= 1.0 - dt / 2))

    result = evaluator.round(policy, number, watch)
    for values, new in zip(
        (found.speed, found.across, found.kept, found.again), (speed, across, kept, result.success), strict=True
    ):
        values.append(new[pushed])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("policies", nargs="+", help="runs, checkpoints, or pretrained:NAME")
    parser.add_argument("--rounds", type=int, default=8, help="rounds of at most 256 episodes (default 8)")
    parser.add_argument("--fastest", type=float, default=0.8, help="longest push, m/s (default 0.8)")
    parser.add_argument("--settings", nargs="+", default=[], help="such as start.board_fixed=1")
    parser.add_argument("--frozen", action="store_true", help="keep the joint targets from the push on")
    options = parser.parse_args()
    names = ["policy", "direction", "push, m/s", "robots", "kept", "again"]
    print(f"| {' | '.join(names)} |", "|---" * len(names) + "|", sep="\n")
    edges = [options.fastest * i / 8 for i in range(9)]
    for policy in options.policies:
        agent = TrainedPolicy.load(policy)
        found = measure(agent, options.rounds, options.fastest, options.settings, options.frozen)
        for across, low, high, robots, *shares in found.rows(edges):
            cells = [f"{100 * share:.0f} %" if robots else "–" for share in shares]
            direction = "across" if across else "along"
            print(
                f"| {agent.name} | {direction} | {low:.1f} to {high:.1f} | {robots} | {' | '.join(cells)} |", flush=True
            )


if __name__ == "__main__":
    main()
