"""Average the weights of policies into one policy file.

    python tools/average_policies.py runs/skatemount/2026-..._a runs/skatemount/2026-..._b --out average.safetensors

The mean of policies that were trained from one another often succeeds more often than each of them (Wortsman et al.,
"Model soups", arXiv 2203.05482). The card is that of the last policy.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import torch

from skatemount.agents.trained_policy import MODULE, TrainedPolicy
from skatemount.runs.checkpoint import save_policy


def average(agents: list[TrainedPolicy]) -> TrainedPolicy:
    """Return the last policy with the mean weights, and mean normalization statistics, of all.

    Raises:
        ValueError: Their networks or observations differ.
    """
    last, states = agents[-1], [agent.networks.state_dict() for agent in agents]
    shapes = [{name: value.shape for name, value in state.items()} for state in states]
    for agent, found in zip(agents, shapes):
        if found != shapes[-1] or agent.card.observation != last.card.observation:
            raise ValueError(f"{agent.name} has other networks or observations than {last.name}")
    mean = {name: torch.stack([state[name].double() for state in states]).mean(0) for name in states[0]}
    last.networks.load_state_dict({name: value.to(states[-1][name].dtype) for name, value in mean.items()})
    return last


def main() -> None:
    """Write the file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("policies", nargs="+", help="runs, checkpoints, files, or pretrained:NAME")
    parser.add_argument("--out", type=Path, required=True, help="file to write, such as average.safetensors")
    options = parser.parse_args()
    try:
        agent = average([TrainedPolicy.load(each) for each in options.policies])
    except ValueError as error:
        sys.exit(str(error))
    save_policy(options.out, {MODULE: agent.networks}, agent.card)
    print(options.out)


if __name__ == "__main__":
    main()
