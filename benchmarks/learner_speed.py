"""Compare the time of a PPO update with rsl_rl's, for networks of the same sizes, in one run.

    pip install --no-deps rsl-rl-lib==5.5.1
    python benchmarks/learner_speed.py --worlds 1024 --steps 24

One update computes advantages from stored rewards, then takes epochs x minibatches gradient steps of PPO on an
asymmetric actor and critic with normalized inputs. Both learners get the same batch, network sizes, number of threads
and number of gradient steps. Two things favor rsl_rl: our update also computes the values of all states, which rsl_rl
does while it collects, and the process keeps freed memory, which rsl_rl alone would not do. Our networks are symmetric
by default, which rsl_rl's networks cannot be, so plain ones are measured as well.

"medium" and "highest" are torch's precision of float32 matrix products. rsl_rl uses torch's default, "highest".
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import torch
from learner_parts import random_batch
from rsl_rl.algorithms import PPO as RslPPO
from rsl_rl.models import MLPModel
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict, TensorDictBase

from skatemount.config import TrainConfig, compose
from skatemount.envs import MountTask
from skatemount.envs.mdp import Mdp
from skatemount.losses.ppo import PPO
from skatemount.training.setup import make_networks
from skatemount.utils.cores import available_cores
from skatemount.utils.memory import disable_malloc_trim

ACTIONS = 12


def ours(config: TrainConfig, mdp: Mdp, batch: TensorDictBase) -> Callable[[], None]:
    """Return a function that updates our networks from a batch, with actions of these networks."""
    networks = make_networks(config, mdp)
    ppo = PPO(config.algorithm, networks, 0.04, bf16=config.precision == "bf16")
    with torch.no_grad():
        batch = networks.actor(batch.clone())
    return lambda: ppo.update(batch.clone(recurse=False)) and None


def theirs(config: TrainConfig, batch: TensorDictBase) -> Callable[[], None]:
    """Return a function that updates rsl_rl's networks from a batch."""
    worlds, steps = batch.shape
    algorithm, network = config.algorithm, config.network
    states = TensorDict({key: batch[key] for key in ("observation", "privileged")}, [worlds, steps])
    groups = {"actor": ["observation"], "critic": ["observation", "privileged"]}

    def model(which: str, outputs: int, cells: list[int], distribution: dict | None) -> MLPModel:
        return MLPModel(states[:, 0], groups, which, outputs, list(cells), network.activation, True, distribution)

    gaussian = {"class_name": "GaussianDistribution", "init_std": network.init_std}
    storage = RolloutStorage("rl", worlds, steps, states[:, 0], [ACTIONS])
    ppo = RslPPO(
        model("actor", ACTIONS, network.actor, gaussian),
        model("critic", 1, network.critic, None),
        storage,
        num_learning_epochs=algorithm.epochs,
        num_mini_batches=algorithm.minibatches,
        entropy_coef=algorithm.entropy_coeff,
        use_clipped_value_loss=algorithm.clip_value,
        desired_kl=algorithm.target_kl,
    )
    following = batch["next"]
    with torch.inference_mode():
        for t in range(steps):
            ppo.act(states[:, t])
            extras = {"time_outs": following["truncated"][:, t, 0]}
            ppo.process_env_step(states[:, t], following["reward"][:, t, 0], following["done"][:, t, 0], extras)

    def update() -> None:
        # Clearing rsl_rl's storage leaves the data in place, so every update uses the same batch.
        with torch.no_grad():
            ppo.compute_returns(states[:, -1])
        ppo.update()

    return update


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--worlds", type=int, default=1024)
    parser.add_argument("--steps", type=int, default=24)
    parser.add_argument("--network", default="small", help="a file of conf/network")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--bf16", action="store_true", help="also ours in bfloat16: very slow without hardware for it")
    parser.add_argument("--json", type=Path, help="file for the figures")
    options = parser.parse_args()
    torch.manual_seed(0)
    torch.set_num_threads(available_cores())
    disable_malloc_trim()
    settings = [f"network={options.network}", "network.normalize=true"]
    config, plain = (compose(None, [*settings, f"network.symmetric={flag}"]) for flag in ("true", "false"))
    mdp = MountTask(config=config).make_mdp(torch.Generator())
    batch = random_batch(mdp, options.worlds, options.steps)
    rsl_rl = theirs(config, batch)
    runs = {
        "skatemount, medium": ("medium", ours(config, mdp, batch)),
        "skatemount, plain": ("medium", ours(plain, mdp, batch)),
        "skatemount, compiled": ("medium", ours(compose(None, [*settings, "algorithm.compile=true"]), mdp, batch)),
        "rsl_rl, medium": ("medium", rsl_rl),
        "rsl_rl, highest": ("highest", rsl_rl),
    }
    if options.bf16:
        runs["skatemount, bf16"] = ("medium", ours(compose(None, [*settings, "precision=bf16"]), mdp, batch))
    best = dict.fromkeys(runs, float("inf"))
    for round_ in range(options.rounds + 1):
        for name, (precision, run) in runs.items():
            torch.set_float32_matmul_precision(precision)
            start = time.perf_counter()
            run()
            if round_:  # the first warms up
                best[name] = min(best[name], time.perf_counter() - start)
    print(
        f"{options.worlds} x {options.steps} steps, {config.algorithm.epochs} epochs x {config.algorithm.minibatches} "
        f"minibatches, {list(config.network.actor)}, {torch.get_num_threads()} threads; best of {options.rounds}"
    )
    ratio = best["rsl_rl, medium"]
    for name, took in best.items():
        print(f"  {name:20s} {1000 * took:8.1f} ms   {ratio / took:.2f} x rsl_rl, medium")
    if options.json:
        options.json.write_text(json.dumps({"seconds": best, "worlds": options.worlds}, indent=2))


if __name__ == "__main__":
    main()
