"""Put a trained policy into the package, with what was measured of it on its card.

    python tools/ship_policy.py runs/skatemount/2026-..._balance balance --suites balance-fixed --episodes 2000 \
        --command "make train"

writes `skatemount/policies/balance.safetensors` and `balance.json`. The critic stays with the policy, so that other
stages can start from it.
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
"""What an evaluation notes of its policy: the card says it itself, or it concerns one machine alone."""


def main() -> None:
    """Evaluate, then write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("checkpoint", help="a run, a checkpoint, a file")
    parser.add_argument("name", help="of the shipped policy: pretrained:NAME")
    parser.add_argument("--suites", nargs="+", required=True, help="suites to evaluate in; all for every one")
    parser.add_argument("--episodes", type=int, default=2000, help="in each suite")
    parser.add_argument("--command", required=True, help="the command that trained it")
    parser.add_argument("--notes", default="", help="anything else that a user should know")
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
    # Where runs lay on the machine that trained it concerns nobody else.
    card.config["logger"]["root"], card.config["resume"] = "runs", None
    card.notes = " ".join(filter(None, (f"Trained by: {options.command}.", options.notes, failure_modes(results))))
    folder = Path(skatemount.__file__).parent / "policies"
    folder.mkdir(exist_ok=True)
    save_policy(folder / f"{options.name}.safetensors", {MODULE: agent.networks}, card)


def failure_modes(results: dict[str, Evaluation]) -> str:
    """What ended the failed episodes, in a sentence a suite."""
    return " ".join(
        f"Failures in {name}, of {result.episodes} episodes: {report.failures(result)}."
        for name, result in results.items()
    )


if __name__ == "__main__":
    main()
