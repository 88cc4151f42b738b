"""Measure how much of its speed a training keeps beside other programs, for one or two versions of the code.

    python benchmarks/shared_machine.py
    python benchmarks/shared_machine.py --against 5ce7322 --rounds 3
    python benchmarks/shared_machine.py --settings physics.threads=1 torch_threads=1

Three cases are measured, in turn, in every round:

* quiet: one training;
* busy: one training beside a process that computes without a pause on one core;
* pair: two trainings at once, of which the speeds are added.

A speed is the median over a training's iterations, all but the first two. Printed are the medians over the rounds and
their ratios to the quiet speed of the same version. Run it while nothing else uses the machine.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

from same_as import ROOT, checkout, environment, rates

COMMAND = (
    "+stage=balance total_frames={frames} logger.evaluate_every=0 logger.final_episodes=0 logger.tensorboard=false"
)
ITERATION = 1024 * 24
"""Environment steps of one iteration."""

CASES = {"quiet": (1, 0), "busy": (1, 1), "pair": (2, 0)}
"""Number of trainings, and of busy processes beside them, by the case's name."""


def main() -> None:
    """Measure every case with every version, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--against", metavar="COMMIT", help="another version to measure side by side")
    parser.add_argument("--rounds", type=int, default=3, help="times that each case is measured (default 3)")
    parser.add_argument("--iterations", type=int, default=7, help="of each training, at least 3 (default 7)")
    parser.add_argument("--settings", nargs="*", default=[], help="settings of all trainings")
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES), help="what to measure (default all)")
    parser.add_argument("--json", type=Path, help="write the figures into this file")
    options = parser.parse_args()
    command = [*COMMAND.format(frames=max(options.iterations, 3) * ITERATION).split(), *options.settings]
    print(f"{len(os.sched_getaffinity(0))} cores; {' '.join(command)}", flush=True)
    speeds: dict[str, dict[str, list[float]]] = {}
    with checkout(options.against) if options.against else nullcontext() as other:
        trees = {"this version": ROOT} | ({options.against: other} if other else {})
        for i in range(options.rounds):
            for case in options.cases:
                # The order alternates: a machine that slows down during a round must not favor one version.
                for name in list(trees) if i % 2 == 0 else reversed(list(trees)):
                    speed = case_speed(trees[name], command, *CASES[case])
                    speeds.setdefault(name, {}).setdefault(case, []).append(speed)
                    print(f"  round {i + 1}, {case}, {name}: {speed:,.0f} steps/s", flush=True)
    medians = {name: {case: statistics.median(all_) for case, all_ in cases.items()} for name, cases in speeds.items()}
    for name, cases in medians.items():
        quiet = cases.get("quiet")
        figures = (f"{c} {v:,.0f} steps/s" + (f" ({v / quiet:.2f})" if quiet else "") for c, v in cases.items())
        print(f"{name}: {', '.join(figures)}")
    if options.json:
        result = {"command": command, "rounds": options.rounds, "steps_per_s": medians}
        options.json.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")


def case_speed(tree: Path, command: list[str], trainings: int, busy: int) -> float:
    """Return the summed speed of some trainings at once beside some busy processes, in environment steps a second."""
    with tempfile.TemporaryDirectory() as folder, busy_processes(busy):
        roots = [Path(folder) / str(i) for i in range(trainings)]
        started = [
            subprocess.Popen(
                [sys.executable, "-m", "skatemount.train", *command, f"logger.root={root}"],
                env=environment(tree),
                cwd=tree,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
            )
            for root in roots
        ]
        for process in started:
            _, errors = process.communicate()
            if process.returncode:
                sys.exit(f"a training ended with status {process.returncode}: {errors}")
        return sum(statistics.median(rates(root)[2:]) for root in roots)


@contextmanager
def busy_processes(number: int) -> Iterator[None]:
    """Keep this many processes computing during a ``with`` block."""
    processes = [multiprocessing.Process(target=_compute, daemon=True) for _ in range(number)]
    for process in processes:
        process.start()
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.join()


def _compute() -> None:
    while True:
        pass


if __name__ == "__main__":
    main()
