"""Put a trained policy into the package, and the results of its evaluations on its card.

    python tools/ship_policy.py runs/skatemount/2026-..._balance balance --suites balance-fixed --episodes 2000 \
        --command "make train"

writes `skatemount/policies/balance.safetensors` and `balance.json`. The file includes the critic, so that the training
of other stages can start from it.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import skatemount
from skatemount.agents.trained_policy import MODULE, TrainedPolicy
from skatemount.evaluation import report
from skatemount.evaluation.results import Evaluation
from skatemount.evaluation.suite_task import EvaluationTask, load_suite, members_of
from skatemount.runs.checkpoint import save_policy

LOCAL = ("checkpoint", "stage", "frames", "sha256", "record")
"""Entries of an evaluation that the card has already, or that hold on one machine only."""


def main() -> None:
    """Evaluate a policy and write its files."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("checkpoint", help="a run, a checkpoint, a file")
    parser.add_argument("name", help="name of the shipped policy, pretrained:NAME")
    parser.add_argument("--suites", nargs="+", required=True, help="suites to evaluate in; all for all of them")
    parser.add_argument("--episodes", type=int, default=2000, help="episodes in each suite (default 2000)")
    parser.add_argument("--command", required=True, help="the command that trained it")
    parser.add_argument("--notes", default="", help="further notes for users")
    options = parser.parse_args()
    agent = TrainedPolicy.load(options.checkpoint)
    results: dict[str, Evaluation] = {}
    for suite in (each for name in options.suites for each in members_of(load_suite(name))):
        result = EvaluationTask.of(agent, suite).evaluate(options.episodes)
        result.evaluated = {key: value for key, value in result.evaluated.items() if key not in LOCAL}
        print(suite.name, report.table(result), sep="\n", flush=True)
        results[suite.name] = result
    card = agent.card
    card.suites = {name: result.to_dict(failed_episodes=False) for name, result in results.items()}
    # Paths of the machine that trained the policy mean nothing elsewhere.
    card.config["logger"]["root"], card.config["resume"] = "runs", None
    for holder, key in ((card.config, "init_from"), (card.config["algorithm"], "teacher")):
        if holder.get(key) is not None:
            holder[key] = Path(holder[key]).name
    card.notes = " ".join(filter(None, (f"Trained by: {options.command}.", options.notes, failure_modes(results))))
    folder = Path(skatemount.__file__).parent / "policies"
    folder.mkdir(exist_ok=True)
    save_policy(folder / f"{options.name}.safetensors", {MODULE: agent.networks}, card)


def failure_modes(results: dict[str, Evaluation]) -> str:
    """Return the ends of the failed episodes, in a sentence per suite."""
    return " ".join(
        f"Failures in {name}, of {result.episodes} episodes: {report.failures(result)}."
        for name, result in results.items()
    )


if __name__ == "__main__":
    main()
