"""Compare `mujoco.batch` with and without engine memory of each world's own, in speed and in bytes, in one run.

    python benchmarks/memory_of_worlds.py

With one engine memory per thread, every step first recomputes the positions and velocities of its world. With one per
world, it continues from those of the last step. Both step the same states of a policy with the same targets, in turns,
and must reach the same states bit for bit. All rounds count, except for the first, which warms up.
"""

from __future__ import annotations

import argparse
import json
import resource
import time
from pathlib import Path

import mujoco
import numpy as np
import torch
from mujoco.batch import Batch

from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.envs.mount_env import MountEnv
from skatemount.envs.task import MountTask
from skatemount.evaluation.evaluator import deterministic
from skatemount.profiling.measure import in_fresh_process
from skatemount.utils.cores import available_cores

SETTLE, STEPS = 50, 12
STAGE = mujoco.mjtStage.mjSTAGE_VEL.value


def trajectory(policy: str, worlds: int) -> tuple[mujoco.MjModel, np.ndarray, list[np.ndarray], np.ndarray, int]:
    """Return what a policy's rollout needs to be stepped again.

    Args:
        policy: Name of a shipped policy.
        worlds: Number of worlds.

    Returns:
        The model, the state of every world, the targets of the following control steps, the indices of the actuators,
        and the number of substeps of a control step.
    """
    agent = TrainedPolicy.load(f"pretrained:{policy}")
    env = MountEnv(MountTask(stage="unfixed"), num_worlds=worlds, random_phase=True)
    data, targets = env.reset(), []
    with deterministic():
        for step in range(SETTLE + STEPS):
            if step == SETTLE:
                state = env.physics.raw_state()
            data = agent.networks.actor(data)
            if step >= SETTLE:
                targets.append(env.mdp.targets(data["action"]).double().numpy())
            _, data = env.step_and_maybe_reset(data)
    found = env.physics.model, state, targets, env.physics.index.actuators, env.task.config.physics.substeps
    env.close()
    return found


def bytes_per_world(model: mujoco.MjModel, worlds: int, persistent: bool) -> float:
    """Return the memory that a world adds to this process, bytes; call in a fresh process."""
    before = _taken()
    batch = Batch(model, worlds, available_cores(), persistent=persistent)
    batch.bind("sensordata")
    batch.step(nstep=4, stage=STAGE)
    return (_taken() - before) / worlds


def _taken() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--policy", default="approach", help="a shipped policy of the default observation")
    parser.add_argument("--worlds", type=int, nargs="+", default=[64, 1024, 4096])
    parser.add_argument("--rounds", type=int, default=8)
    parser.add_argument("--json", type=Path, help="file for the figures")
    options = parser.parse_args()
    torch.manual_seed(0)
    rows = []
    for worlds in options.worlds:
        model, start, targets, actuators, substeps = trajectory(options.policy, worlds)
        batches = {kept: Batch(model, worlds, available_cores(), persistent=kept) for kept in (False, True)}
        took = dict.fromkeys(batches, 0.0)
        for round_ in range(options.rounds + 1):
            for kept, batch in batches.items():
                batch.bind("sensordata")
                batch.state[:] = start
                batch.forward()
                for each in targets:
                    batch.bind("ctrl")[:, actuators] = each
                    begin = time.perf_counter()
                    batch.step(nstep=substeps, stage=STAGE)
                    if round_:  # the first warms up
                        took[kept] += time.perf_counter() - begin
        if not np.array_equal(batches[False].state, batches[True].state):
            raise SystemExit("the two reached different states")
        row = {"worlds": worlds, "speed": took[False] / took[True]}
        row |= {
            f"bytes_per_world_{name}": in_fresh_process(bytes_per_world, model, worlds, kept)
            for name, kept in (("shared", False), ("own", True))
        }
        rows.append(row)
        print(
            f"{worlds:5d} worlds: {row['speed']:.3f} times as fast with memory of their own, which takes "
            f"{row['bytes_per_world_own'] / 1024:.0f} KiB a world ({row['bytes_per_world_shared'] / 1024:.0f} without)",
            flush=True,
        )
    if options.json:
        options.json.write_text(json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    main()
