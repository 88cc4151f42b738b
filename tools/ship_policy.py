"""Put a trained policy into the package, with what was measured of it on its card.

    python tools/ship_policy.py runs/skatemount/2026-..._balance balance --suites balance --episodes 2000 \
        --command "make train"

writes `skatemount/policies/balance.safetensors` and `balance.json`. The critic stays with the policy, so that other
stages can start from it.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import skatemount
from skatemount.agent import MODULE, Agent
from skatemount.benchmark.evaluation import EVALUATION_SEED, evaluate_policy
from skatemount.benchmark.suites import trial_config
from skatemount.checkpoint import save_policy


def main() -> None:
    """Evaluate, then write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("checkpoint", help="a run, a checkpoint, a file")
    parser.add_argument("name", help="of the shipped policy: pretrained:NAME")
    parser.add_argument("--suites", nargs="+", required=True, help="stages to evaluate in")
    parser.add_argument("--episodes", type=int, default=2000)
    parser.add_argument("--command", required=True, help="the command that trained it")
    parser.add_argument("--notes", default="", help="failure modes, anything a user should know")
    options = parser.parse_args()
    agent = Agent.load(options.checkpoint)
    card = agent.card
    card.suites = {}
    for suite in options.suites:
        config = trial_config(agent.config, suite, [])
        result = evaluate_policy(agent.networks, config, options.episodes, seed=EVALUATION_SEED)
        print(suite, result.table(), sep="\n")
        card.suites[suite] = result.to_dict()
    # Where runs lay on the machine that trained it concerns nobody else.
    card.config["logger"]["root"] = "runs"
    card.notes = f"Trained by: {options.command}. {options.notes}".strip()
    folder = Path(skatemount.__file__).parent / "policies"
    folder.mkdir(exist_ok=True)
    save_policy(folder / f"{options.name}.safetensors", {MODULE: agent.networks}, card)


if __name__ == "__main__":
    main()
