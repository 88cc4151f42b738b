"""Measure how long a multirun takes with jobs beside each other, compared with one after the other.

    python benchmarks/launchers.py
    python benchmarks/launchers.py --seeds 4 --launchers joblib submitit_local --rounds 3

Each multirun trains the same jobs, seeds of one stage, in a new folder. One after the other, a job has every core;
with a launcher it has its share of them (`torch_threads=0 physics.threads=0`). The ways take turns, in every round. A
time is the whole command's, its start included. Printed are the medians over the rounds, and their ratio to one after
the other: below 1 the launcher is faster. Nothing else should run on the machine.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ALONE = "one after the other"
FIXED = [
    "logger.evaluate_every=0",
    "logger.final_episodes=0",
    "logger.tensorboard=false",
    "logger.checkpoint_every=1000000",
    "logger.plot_every=1e6",
]


def measure(way: str, seeds: int, settings: list[str], cores: list[int]) -> float:
    """Return the time of a multirun, s.

    Args:
        way: `ALONE`, or the name of a launcher.
        seeds: Number of jobs.
        settings: Settings of every job.
        cores: Cores that the multirun may use.
    """
    launcher = [] if way == ALONE else [f"launcher={way}"]
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-W", "ignore", "-m", "skatemount.train", "-m", *FIXED, *settings, *launcher]
        command += [f"seed={','.join(map(str, range(seeds)))}", f"logger.root={folder}"]
        environment = {name: value for name, value in os.environ.items() if name != "OMP_NUM_THREADS"}
        environment["PYTHONPATH"] = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
        start = time.perf_counter()
        done = subprocess.run(
            ["taskset", "-c", ",".join(map(str, cores)), *command], env=environment, capture_output=True, text=True
        )
        if done.returncode:
            sys.exit(done.stderr[-3000:])
        return time.perf_counter() - start


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--launchers", nargs="+", default=["joblib"], help="launchers to compare (default joblib)")
    parser.add_argument("--seeds", type=int, default=3, help="number of jobs (default 3)")
    parser.add_argument("--rounds", type=int, default=2, help="times that each way is measured (default 2)")
    parser.add_argument("--cores", type=int, nargs="+", help="cores to use (default all)")
    parser.add_argument(
        "--settings", nargs="*", default=["stage=balance", "total_frames=300000"], help="settings of all jobs"
    )
    parser.add_argument("--json", type=Path, help="write the figures into this file")
    options = parser.parse_args()
    cores = options.cores or sorted(os.sched_getaffinity(0))
    ways = [ALONE, *options.launchers]
    found: dict[str, list[float]] = {way: [] for way in ways}
    for i in range(options.rounds):
        for way in ways if i % 2 == 0 else ways[::-1]:
            found[way].append(measure(way, options.seeds, options.settings, cores))
            print(f"round {i + 1}, {way}: {found[way][-1]:.1f} s", flush=True)
    medians = {way: statistics.median(times) for way, times in found.items()}
    print(f"{options.seeds} jobs of {' '.join(options.settings)} on {len(cores)} cores")
    for way, seconds in medians.items():
        print(f"  {way}: {seconds:.1f} s, {seconds / medians[ALONE]:.2f} x one after the other")
    if options.json is not None:
        document = {"cores": len(cores), "settings": options.settings, "seeds": options.seeds, "seconds": found}
        options.json.write_text(json.dumps(document, indent=2) + "\n")


if __name__ == "__main__":
    main()
