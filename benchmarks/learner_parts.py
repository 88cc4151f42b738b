"""Compare the time of a PPO update with and without each of the learner's own fast paths, in one run.

    python benchmarks/learner_parts.py
    python benchmarks/learner_parts.py --worlds 256 --rounds 5

Every variant updates the default network from the same batch:

* as shipped;
* torch's ELU in place of `skatemount.models.activations.ELU`;
* the plain symmetric forward pass, with the weight and its image, in place of the even and odd parts.

Measured is the CPU time of the process on one thread, which other programs on the machine change little. Variants take
turns, in an order that changes from round to round, so that a slow moment hits all of them alike. Printed are the
medians, and the median over the rounds of each variant's time divided by the shipped one's in the same round. A ratio
of 1.10 means that the update takes 10 % longer without that part.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import statistics
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from unittest import mock

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn

from skatemount.config import TrainConfig, compose
from skatemount.envs import MountTask
from skatemount.envs.mdp import Mdp
from skatemount.losses.ppo import PPO
from skatemount.models import actor_critic, symmetry
from skatemount.training.setup import make_networks
from skatemount.utils.memory import disable_malloc_trim

SHIPPED = "as shipped"


def random_batch(mdp: Mdp, worlds: int, steps: int) -> TensorDict:
    """Return a batch of noise, ``[worlds, steps]``, with the keys that the collector of a task yields."""
    terminated = torch.rand(worlds, steps, 1) < 0.01
    truncated = (torch.rand(worlds, steps, 1) < 0.005) & ~terminated
    states = {
        "observation": torch.randn(worlds, steps, mdp.observation.size),
        "privileged": torch.randn(worlds, steps, mdp.privileged.size),
    }
    following = {
        key: torch.cat((value[:, 1:], torch.randn(worlds, 1, value.shape[-1])), 1) for key, value in states.items()
    }
    following |= {"reward": torch.randn(worlds, steps, 1), "terminated": terminated, "truncated": truncated}
    following["done"] = terminated | truncated
    return TensorDict(states | {"next": TensorDict(following, [worlds, steps])}, [worlds, steps])


@contextlib.contextmanager
def torch_elu() -> Iterator[None]:
    """Build networks with torch's ELU."""
    with mock.patch.dict(actor_critic.ACTIVATION_CLASSES, elu=nn.ELU):
        yield


@contextlib.contextmanager
def plain_forward() -> Iterator[None]:
    """Let symmetric networks multiply with the whole weight, the mean of a free one and its image."""

    def unchanged(network: symmetry.EquivariantMLP, values: Tensor) -> Tensor:
        return values

    def forward(network: symmetry.EquivariantMLP, values: Tensor) -> Tensor:
        return nn.Sequential.forward(network, values)

    with mock.patch.multiple(symmetry.EquivariantMLP, to_even_odd=unchanged, forward_even_odd=forward):
        yield


VARIANTS: dict[str, Callable[[], contextlib.AbstractContextManager[None]]] = {
    SHIPPED: contextlib.nullcontext,
    "torch's ELU": torch_elu,
    "plain symmetric forward": plain_forward,
}


def make_update(config: TrainConfig, mdp: Mdp, batch: TensorDictBase) -> Callable[[], None]:
    """Return a function that updates new networks from a batch, with actions of these networks."""
    torch.manual_seed(0)
    networks = make_networks(config, mdp)
    ppo = PPO(config.algorithm, networks, config.physics.control_step, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        acted = networks.actor(batch.clone())

    def update() -> None:
        ppo.update(acted.clone(recurse=False))

    return update


def measure(config: TrainConfig, worlds: int, steps: int, rounds: int) -> dict[str, list[float]]:
    """Return the CPU seconds of each variant's update in every round; a first round warms up and is left out."""
    mdp = MountTask(config=config).make_mdp(torch.Generator())
    batch = random_batch(mdp, worlds, steps)
    updates = {}
    for name, variant in VARIANTS.items():
        with variant():
            updates[name] = make_update(config, mdp, batch)
    took: dict[str, list[float]] = {name: [] for name in VARIANTS}
    names = list(VARIANTS)
    for round_ in range(rounds + 1):
        for name in names[round_ % len(names) :] + names[: round_ % len(names)]:
            with VARIANTS[name]():
                start = time.process_time()
                updates[name]()
                if round_:
                    took[name].append(time.process_time() - start)
    return took


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--worlds", type=int, default=1024)
    parser.add_argument("--steps", type=int, default=24, help="control steps of each world in the batch (default 24)")
    parser.add_argument("--rounds", type=int, default=20, help="timed updates of each variant (default 20)")
    parser.add_argument("--json", type=Path, help="file for the figures")
    options = parser.parse_args()
    torch.set_num_threads(1)
    torch.set_float32_matmul_precision("medium")
    disable_malloc_trim()
    took = measure(compose(None, []), options.worlds, options.steps, options.rounds)
    medians = {name: statistics.median(times) for name, times in took.items()}
    ratios = {
        name: statistics.median(mine / shipped for mine, shipped in zip(times, took[SHIPPED]))
        for name, times in took.items()
    }
    print(f"one update of {options.worlds} x {options.steps} steps on one thread, {options.rounds} rounds")
    for name, median in medians.items():
        print(f"  {name:24s} {1000 * median:8.1f} ms   {ratios[name]:.3f} x as shipped")
    if options.json:
        figures = {"worlds": options.worlds, "steps": options.steps, "seconds": medians, "ratios": ratios}
        options.json.write_text(json.dumps(figures, indent=2) + "\n")


if __name__ == "__main__":
    main()
