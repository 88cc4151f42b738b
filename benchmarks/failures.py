"""Sort the failed episodes of suites by what the robot does in their last second.

    python benchmarks/failures.py pretrained:robust --suites mount-fixed far

Printed for each suite, over one round of at most 256 episodes of its first variant, is the success, and the number of
failed episodes of each kind:

* ended early: a termination, such as a fall, ended the episode;
* hooked: at least two feet are on the deck, and another part of the robot touches something most of the time. A foot
  hangs over the deck's edge, and the leg lies on it;
* stepped off: the robot had been mounted for a whole second before;
* away: no foot is on the deck at any time;
* other: neither of these.

``--noise`` adds normal noise to the actions, as exploration does: a policy may need it to free itself.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.envs import MountEnv, success
from skatemount.evaluation.suite_task import EvaluationTask, load_suite

KINDS = ("ended early", "hooked", "stepped off", "away", "other")
MOST = 0.6
"""Share of the last second in which a hooked leg touches something."""


@dataclass
class LastSecond:
    """Contacts in the last second of ``[N]`` episodes, and how long each robot was mounted.

    Attributes:
        early: ``[N]`` bool, a termination ended the episode.
        feet: ``[T, N]`` number of feet on the deck in each control step of the second.
        touching: ``[T, N]`` bool, a part of the robot other than the feet touches something.
        longest: ``[N]`` longest time that the robot was mounted without a break, s.
    """

    early: Tensor
    feet: Tensor
    touching: Tensor
    longest: Tensor

    def kinds(self) -> Tensor:
        """Return the index in `KINDS` of each episode, ``[N]`` int64, as if all had failed."""
        hooked = ((self.feet >= 2) & self.touching).float().mean(0) > MOST
        away = (self.feet == 0).all(0)
        # The first kind that is true.
        tests = torch.stack([self.early, hooked, self.longest >= 1.0, away, torch.ones_like(away)])
        return tests.int().argmax(0)


class Noisy:
    """A policy with noise in its actions.

    Args:
        policy: The policy.
        std: Standard deviation of the noise.
    """

    def __init__(self, policy: Any, std: float):
        self._policy, self._std = policy, std

    def actor_in(self, env: MountEnv) -> Callable[[TensorDictBase], TensorDictBase]:
        """Return the actor for an environment."""
        actor = self._policy.actor_in(env)

        def act(state: TensorDictBase) -> TensorDictBase:
            state = actor(state)
            state["action"] = state["action"] + self._std * torch.randn_like(state["action"])
            return state

        return act


def measure(agent: TrainedPolicy, suite: str, settings: list[str], noise: float) -> tuple[int, Tensor]:
    """Run a round of a suite's episodes.

    Args:
        agent: The policy.
        suite: Name of the suite.
        settings: Changes of the suite's settings.
        noise: Standard deviation of the noise in the actions.

    Returns:
        The number of episodes, and the kinds of the failed ones, ``[failures]``.
    """
    task = EvaluationTask.of(agent, load_suite(suite), settings)
    evaluator = task.evaluator(next(iter(task.configs)))
    env: MountEnv = evaluator.env
    feet, touching, longest = [], [], torch.zeros(env.num_worlds)

    def watch(step: int) -> None:
        sim, episode = env.sim, env.episode
        torch.maximum(longest, episode.mounted_time, out=longest)
        feet.append(episode.on_deck.sum(1))
        touching.append(success.body_contacts(sim).any(1))

    try:
        result = evaluator.round(Noisy(agent.policy, noise) if noise else agent.policy, 0, watch)
    finally:
        evaluator.close()
    second = round(1 / env.mdp.context.control_step)
    last = LastSecond(result.end != 0, torch.stack(feet[-second:]), torch.stack(touching[-second:]), longest)
    return len(result.success), last.kinds()[~result.success]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("policies", nargs="+", help="runs, checkpoints, or pretrained:NAME")
    parser.add_argument("--suites", nargs="+", default=["mount-fixed", "mount-unfixed", "far"])
    parser.add_argument("--noise", type=float, default=0.0, help="standard deviation of noise in the actions")
    parser.add_argument("--settings", nargs="+", default=[], help="such as sensing=default")
    options = parser.parse_args()
    print("| policy | suite | success |", *[f"{kind} |" for kind in KINDS])
    print("|---" * (3 + len(KINDS)) + "|")
    for policy in options.policies:
        agent = TrainedPolicy.load(policy)
        for suite in options.suites:
            episodes, kinds = measure(agent, suite, options.settings, options.noise)
            counts = [f"{int((kinds == index).sum())} |" for index in range(len(KINDS))]
            rate = 100 * (1 - len(kinds) / episodes)
            print(f"| {agent.name} | {suite} | {rate:.1f} % |", *counts, flush=True)


if __name__ == "__main__":
    main()
