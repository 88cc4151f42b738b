"""Print how long the command line takes to answer: a misspelt setting, the help, and a training's first iteration.

    python benchmarks/startup_time.py
    python benchmarks/startup_time.py --rounds 5

`import torch` is timed in the same rounds, for comparison: a mistake in the settings is answered without it. Times are
medians of whole processes, in seconds; the ratios are to `import torch`.
"""

from __future__ import annotations

import argparse
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time

TRAIN = [sys.executable, "-m", "skatemount.train"]
COMMANDS = {
    "import torch": [sys.executable, "-c", "import torch"],
    "a misspelt setting": [*TRAIN, "stage=balance", "sed=1"],
    "a misspelt stage": [*TRAIN, "stage=balence"],
    "a value out of range": [*TRAIN, "stage=balance", "seed=-1"],
    "a misspelt reward": [*TRAIN, "stage=balance", "reward.aliv.weight=1"],
    "--help": [*TRAIN, "--help"],
    "--cfg job": [*TRAIN, "stage=balance", "--cfg", "job"],
}


def main() -> None:
    """Time every command in turn, then print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3, help="times that each command is run (default 3)")
    options = parser.parse_args()
    if options.rounds < 1:
        sys.exit(f"--rounds={options.rounds} must be at least 1")
    taken: dict[str, list[float]] = {name: [] for name in (*COMMANDS, "first iteration of a training")}
    for _ in range(options.rounds):
        for name, command in COMMANDS.items():
            taken[name].append(seconds(command))
        taken["first iteration of a training"].append(first_iteration())
    medians = {name: statistics.median(values) for name, values in taken.items()}
    print(f"{'':32}{'median, s':>10}{'ratio':>8}")
    for name, value in medians.items():
        print(f"{name:32}{value:10.2f}{value / medians['import torch']:8.2f}")


def seconds(command: list[str]) -> float:
    """Return the duration of a process, s."""
    start = time.perf_counter()
    subprocess.run(command, capture_output=True, env=os.environ | {"MUJOCO_GL": "disable"})
    return time.perf_counter() - start


def first_iteration() -> float:
    """Return the time from the start of a default training to its first line of progress, s."""
    with tempfile.TemporaryDirectory() as root:
        command = [*TRAIN, "stage=balance", f"logger.root={root}", "logger.progress_every=0"]
        start = time.perf_counter()
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        try:
            for line in process.stdout:
                if re.search(r"steps/s", line):
                    return time.perf_counter() - start
        finally:
            process.kill()
            process.wait()
    sys.exit("the training ended before its first iteration")


if __name__ == "__main__":
    main()
