"""Print threads, open files and memory while environments come and go, and while a training runs.

    python benchmarks/leaks.py
    python benchmarks/leaks.py --environments 500 --minutes 3 --json docs/results/faults.json

Environments are built, stepped and closed, and stay referenced; then a training runs for some minutes in the same
process. What grows with their number, or with the time, is a leak.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from skatemount.config import compose  # noqa: E402
from skatemount.envs import MountEnv, MountTask  # noqa: E402
from skatemount.training.callbacks import Callback  # noqa: E402
from skatemount.training.trainer import Trainer  # noqa: E402

MEBI = 2**20


def figures() -> dict[str, float]:
    """Return threads, open files, and resident memory in MiB of this process."""
    status = Path("/proc/self/status").read_text().splitlines()
    (threads,) = (int(line.split()[1]) for line in status if line.startswith("Threads:"))
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    memory = pages * resource.getpagesize() / MEBI
    return {"threads": threads, "files": len(os.listdir("/proc/self/fd")), "memory_mib": round(memory, 1)}


def show(label: str, row: dict[str, float]) -> None:
    """Print a row."""
    print(
        f"{label:>24}: {row['threads']:.0f} threads, {row['files']:.0f} files, {row['memory_mib']:.1f} MiB", flush=True
    )


def environments(number: int, worlds: int) -> list[dict[str, float]]:
    """Build, step and close environments that stay referenced.

    Args:
        number: Number of environments.
        worlds: Worlds of each.
    """
    task = MountTask(stage="unfixed")
    kept: list[MountEnv] = []
    rows = []
    every = max(1, number // 10)
    for n in range(1, number + 1):
        env = MountEnv(task, num_worlds=worlds, threads=2, seed=n)
        env.rollout(3, break_when_any_done=False)
        env.close()
        kept.append(env)
        # The first ones load what all of them share.
        if n == min(5, number) or n % every == 0:
            rows.append({"environments": n} | figures())
            show(f"{n} environments", rows[-1])
    assert all(env.is_closed for env in kept)
    return rows


class Watch(Callback):
    """Notes the figures at even times.

    Args:
        seconds: Time after which the training ends.
    """

    def __init__(self, seconds: float) -> None:
        self.rows: list[dict[str, float]] = []
        self._seconds, self._begun = seconds, time.monotonic()

    def on_iteration_end(self, trainer: Trainer, metrics: dict[str, float]) -> None:
        """Note the figures if it is time, and end the training."""
        elapsed = time.monotonic() - self._begun
        if elapsed >= self._seconds * (len(self.rows) + 1) / 10:
            self.rows.append({"seconds": round(elapsed), "iterations": trainer.iteration} | figures())
            show(f"{elapsed:.0f} s, iteration {trainer.iteration}", self.rows[-1])
        if elapsed >= self._seconds:
            trainer.stop()


def training(seconds: float, worlds: int) -> list[dict[str, float]]:
    """Train for some time, with checkpoints, evaluations and pictures.

    Args:
        seconds: The time.
        worlds: Number of worlds.
    """
    watch = Watch(seconds)
    with tempfile.TemporaryDirectory() as root:
        given = [f"physics.num_worlds={worlds}", "network.actor=[32]", "network.critic=[32]", f"logger.root={root}"]
        given += ["physics.threads=1", "torch_threads=1", "episode_length=1.0", "collector.steps_per_env=8"]
        given += ["logger.checkpoint_every=20", "logger.evaluate_every=200", "logger.evaluate_episodes=8"]
        given += ["logger.plot_every=10", "logger.progress_every=1e6", "total_frames=1e12"]
        trainer = Trainer(compose("balance", given), given, callbacks=[watch])
        trainer.train()
        trainer.close()
    return watch.rows


def main() -> None:
    """Measure and print, and write the figures on request."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--environments", type=int, default=500)
    parser.add_argument("--minutes", type=float, default=3.0, help="of the training")
    parser.add_argument("--worlds", type=int, default=4, help="of each environment; the training has twice as many")
    parser.add_argument("--json", type=Path, help="results file to which the figures are added")
    options = parser.parse_args()
    found: dict[str, Any] = {"command": "python benchmarks/leaks.py"}
    found["environments"] = environments(options.environments, options.worlds)
    found["training"] = training(60 * options.minutes, 2 * options.worlds)
    if options.json:
        document = json.loads(options.json.read_text(encoding="utf-8")) if options.json.is_file() else {"format": 1}
        options.json.write_text(json.dumps(document | {"memory": found}, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
