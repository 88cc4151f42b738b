"""Compare the speed of the batched environment with the usual alternatives, in one run.

    python benchmarks/environment_speed.py --worlds 1024 --seconds 8

Prints environment steps per second (one step is one action of one world) and ratios:

* MountEnv: `step_and_maybe_reset` with random actions;
* ParallelEnv: TorchRL's `ParallelEnv` with one composer world per process;
* numpy loop: one composer world per process, without TorchRL.

They take turns, and all rounds count, so that a slow moment of the machine hits all of them alike. For the distance
from raw physics, run `python -m skatemount.bench`.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from dm_control import composer
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase, ParallelEnv

from skatemount.envs import MountEnv, MountTask
from skatemount.utils.cores import available_cores

WARM_UP = 100
"""Number of steps before timing, so that the worlds' episodes end at different times."""

Run = Callable[[float], tuple[int, float]]
"""Steps environments for at least a number of seconds; returns the environment steps and the seconds they took."""


class ComposerWorld(EnvBase):
    """The composer task as a TorchRL environment of one world."""

    def __init__(self, stage: str, seed: int):
        super().__init__(device=torch.device("cpu"))
        self._env = composer.Environment(
            MountTask(stage=stage),
            random_state=seed,
            recompile_mjcf_every_episode=False,
            strip_singleton_obs_buffer_dim=True,
        )
        spec = self._env.action_spec()
        observations = {k: Unbounded(v.shape) for k, v in self._env.observation_spec().items()}
        self.observation_spec = Composite(**observations)
        self.action_spec = Bounded(float(spec.minimum), float(spec.maximum), shape=spec.shape, dtype=torch.float32)
        self.reward_spec = Unbounded((1,))
        self.full_done_spec = Composite(
            {k: Binary(n=1, shape=(1,), dtype=torch.bool) for k in ("done", "terminated", "truncated")}
        )

    def _observation(self, step: Any) -> dict[str, torch.Tensor]:
        return {k: torch.as_tensor(np.asarray(v), dtype=torch.float32) for k, v in step.observation.items()}

    def _reset(self, tensordict: TensorDictBase | None, **kwargs: Any) -> TensorDictBase:
        return TensorDict(self._observation(self._env.reset()), [])

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        step = self._env.step(tensordict["action"].numpy())
        terminated = step.last() and step.discount == 0.0
        done = torch.tensor([step.last()])
        values = self._observation(step) | {
            "reward": torch.tensor([step.reward], dtype=torch.float32),
            "done": done,
            "terminated": torch.tensor([terminated]),
            "truncated": done & ~torch.tensor([terminated]),
        }
        return TensorDict(values, [])

    def _set_seed(self, seed: int | None) -> None:
        pass


def mount_env(env: MountEnv, scale: float) -> Run:
    """Return a function that steps a `MountEnv` with auto-reset and random actions of a standard deviation."""
    actions = [scale * torch.randn(env.num_worlds, 12) for _ in range(16)]

    def run(seconds: float) -> tuple[int, float]:
        data, steps = env.reset(), 0
        for i in range(WARM_UP):
            data["action"] = actions[i % 16]
            _, data = env.step_and_maybe_reset(data)
        start = time.perf_counter()
        while time.perf_counter() - start < seconds:
            data["action"] = actions[steps % 16]
            _, data = env.step_and_maybe_reset(data)
            steps += 1
        return steps * env.num_worlds, time.perf_counter() - start

    return run


def parallel_env(env: ParallelEnv, processes: int, scale: float) -> Run:
    """Return a function that steps a `ParallelEnv` with auto-reset and random actions of a standard deviation."""

    def run(seconds: float) -> tuple[int, float]:
        data, steps, start = env.reset(), 0, time.perf_counter()
        while time.perf_counter() - start < seconds:
            data["action"] = scale * torch.randn(processes, 12)
            _, data = env.step_and_maybe_reset(data)
            steps += 1
        return steps * processes, time.perf_counter() - start

    return run


def _loop(job: tuple[str, int, float, float]) -> tuple[int, float]:
    stage, seed, seconds, scale = job
    torch.set_num_threads(1)
    env = composer.Environment(MountTask(stage=stage), random_state=seed, recompile_mjcf_every_episode=False)
    rng = np.random.default_rng(seed)
    step = env.reset()
    steps, start = 0, time.perf_counter()
    while time.perf_counter() - start < seconds:
        step = env.step(scale * rng.standard_normal(12))
        if step.last():
            env.reset()
        steps += 1
    return steps, time.perf_counter() - start


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--stage", default="balance")
    parser.add_argument("--worlds", type=int, default=1024)
    parser.add_argument("--seconds", type=float, default=8.0, help="least time of each figure and round (default 8)")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument(
        "--action-scale",
        type=float,
        default=0.3,
        help="standard deviation of the random actions (default 0.3: as early in training, with many falls)",
    )
    parser.add_argument("--json", type=Path, help="file for the figures")
    options = parser.parse_args()
    cores, scale = available_cores(), options.action_scale
    torch.manual_seed(0)
    torch.set_num_threads(1)

    env = MountEnv(MountTask(stage=options.stage), num_worlds=options.worlds)
    pool = ParallelEnv(cores, [_maker(options.stage, i) for i in range(cores)])
    workers = multiprocessing.get_context("spawn").Pool(cores)

    def numpy_loop(seconds: float) -> tuple[int, float]:
        done = workers.map(_loop, [(options.stage, i, seconds, scale) for i in range(cores)], chunksize=1)
        return sum(steps for steps, _ in done), max(spent for _, spent in done)

    runs = {
        "MountEnv": mount_env(env, scale),
        "ParallelEnv": parallel_env(pool, cores, scale),
        "numpy loop": numpy_loop,
    }
    for run in runs.values():
        run(1.0)
    done = {name: (0, 0.0) for name in runs}
    for _ in range(options.rounds):
        for name, run in runs.items():
            steps, spent = run(options.seconds)
            done[name] = done[name][0] + steps, done[name][1] + spent
    workers.terminate()
    pool.close()
    env.close()

    rates = {name: steps / spent for name, (steps, spent) in done.items()}
    print(f"{options.stage}, {options.worlds} worlds, {cores} cores; environment steps/s, {options.rounds} rounds")
    for name, rate in rates.items():
        print(f"  {name:12s} {rate:10,.0f}   MountEnv is {rates['MountEnv'] / rate:.2f} x this")
    if options.json:
        options.json.write_text(json.dumps({"worlds": options.worlds, "cores": cores, "steps_per_s": rates}, indent=2))


def _maker(stage: str, seed: int) -> Callable[[], EnvBase]:
    return lambda: ComposerWorld(stage, seed)


if __name__ == "__main__":
    main()
