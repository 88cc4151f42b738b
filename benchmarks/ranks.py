"""Measure how fast several ranks train beside one, and calculate how fast many machines would.

    python benchmarks/ranks.py
    python benchmarks/ranks.py --ranks 1 2 4 --cores 0 1 2 3 --rounds 3
    python benchmarks/ranks.py --megabits 100 --latency 2 --iteration-time 4.5

Every rank has one core, one physics thread, one torch thread and the same number of worlds. The numbers of ranks are
measured in turn, in every round. A speed is the median over a training's iterations, all but the first one; printed are
the medians over the rounds, and their ratio to one rank. The bytes that ranks reduce are counted by the training; those
on the loopback interface are the system's counters over the whole training, divided by the iterations.

The table of machines is calculated, not measured. Each machine is one rank. It needs the measured time of one rank for
an iteration, or the time that --iteration-time gives. A reduction of B bytes by M machines in a ring sends
2 (M - 1) / M B bytes from each machine, in 2 (M - 1) steps that each cost the latency.
"""

from __future__ import annotations

import argparse
import json
import os
import socket
import statistics
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LOOPBACK = Path("/sys/class/net/lo/statistics/tx_bytes")
FIXED = [
    "physics.threads=1",
    "torch_threads=1",
    "logger.evaluate_every=0",
    "logger.final_episodes=0",
    "logger.tensorboard=false",
    "logger.checkpoint_every=1000000",
    "logger.plot_every=1e6",
]


@dataclass
class Measured:
    """A training of some ranks.

    Attributes:
        ranks: Number of ranks.
        rate: Environment steps per second of all ranks together.
        iteration: Time of an iteration, s.
        waiting: Share of that time that rank 0 spends in reductions, which includes waiting for the others.
        reductions: Reductions in an iteration.
        megabytes: Size of what a rank reduces in an iteration.
        loopback: Megabytes on the loopback interface in an iteration, headers included.
    """

    ranks: int
    rate: float
    iteration: float
    waiting: float
    reductions: float
    megabytes: float
    loopback: float


def measure(ranks: int, worlds: int, iterations: int, cores: list[int], settings: list[str]) -> Measured:
    """Train with some ranks, and return what it took."""
    frames = ranks * worlds * 24 * iterations
    given = [*FIXED, f"physics.num_worlds={worlds}", f"total_frames={frames}", *settings]
    with tempfile.TemporaryDirectory() as folder, socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
        probe.close()
        command = [sys.executable, "-W", "ignore", "-m", "torch.distributed.run", f"--nproc-per-node={ranks}"]
        command += [f"--master-port={port}", "-m", "skatemount.train", *given, f"logger.root={folder}"]
        chosen = ",".join(map(str, cores[:ranks]))
        environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
        before = loopback_bytes()
        done = subprocess.run(["taskset", "-c", chosen, *command], env=environment, capture_output=True, text=True)
        sent = loopback_bytes() - before
        if done.returncode:
            sys.exit(done.stderr[-3000:])
        (path,) = Path(folder).glob("*/*/metrics.jsonl")
        rows = [json.loads(line) for line in path.read_text().splitlines()][1:]

    def median(name: str) -> float:
        return statistics.median(row.get(name, 0.0) for row in rows)

    rate = median("Perf/total_fps")
    seconds = ranks * worlds * 24 / rate
    waiting, megabytes = median("Perf/reduction_time") / seconds, median("Perf/reduced_megabytes")
    return Measured(ranks, rate, seconds, waiting, median("Perf/reductions"), megabytes, sent / iterations / 1e6)


def loopback_bytes() -> int:
    """Return the bytes that were sent on the loopback interface; 0 where the system does not say."""
    try:
        return int(LOOPBACK.read_text())
    except OSError:
        return 0


def calculated(
    iteration: float, megabytes: float, reductions: float, machines: int, megabits: float, latency: float
) -> tuple[float, float]:
    """Return the time of an iteration of several machines, s, and its share without the network.

    Args:
        iteration: Time of an iteration of one machine, s.
        megabytes: What a machine reduces in an iteration.
        reductions: Number of these reductions.
        machines: Number of machines.
        megabits: Speed of the network in each direction, Mbit/s.
        latency: Time of one message, ms.
    """
    sent = 2 * (machines - 1) / machines * megabytes * 8 / megabits
    steps = reductions * 2 * (machines - 1) * latency / 1000
    total = iteration + sent + steps
    return total, iteration / total


def main() -> None:
    """Measure, calculate and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--ranks", type=int, nargs="+", default=[1, 2], help="numbers of ranks (default 1 2)")
    parser.add_argument("--cores", type=int, nargs="+", help="cores to use, one for a rank (default the first ones)")
    parser.add_argument("--worlds", type=int, default=512, help="worlds of a rank (default 512)")
    parser.add_argument("--iterations", type=int, default=6, help="of each training (default 6)")
    parser.add_argument("--rounds", type=int, default=2, help="times that each number is measured (default 2)")
    parser.add_argument("--settings", nargs="*", default=["stage=balance"], help="settings of all trainings")
    parser.add_argument("--machines", type=int, nargs="+", default=[2, 8, 32, 128], help="numbers to calculate")
    parser.add_argument("--megabits", type=float, nargs="+", default=[100, 1000], help="network speeds, Mbit/s")
    parser.add_argument("--iteration-time", type=float, help="of one machine in the calculation, s")
    parser.add_argument("--latency", type=float, default=0.3, help="of a message, ms (default 0.3)")
    parser.add_argument("--json", type=Path, help="write the figures into this file")
    options = parser.parse_args()
    cores = options.cores or sorted(os.sched_getaffinity(0))
    ranks = sorted({1, *options.ranks})
    if max(ranks) > len(cores):
        print(f"{max(ranks)} ranks share {len(cores)} cores, so the ratio says nothing about cores of their own")
    found: dict[int, list[Measured]] = {each: [] for each in ranks}
    for i in range(options.rounds):
        for each in ranks if i % 2 == 0 else ranks[::-1]:
            found[each].append(measure(each, options.worlds, max(2, options.iterations), cores, options.settings))
    best = {each: sorted(many, key=lambda m: m.rate)[len(many) // 2] for each, many in found.items()}
    print(f"measured, one core a rank, {options.worlds} worlds a rank, {' '.join(options.settings)}")
    for each, one in best.items():
        print(
            f"  {each} ranks: {one.rate:,.0f} steps/s, {one.rate / best[1].rate:.2f} x one rank; {one.iteration:.2f} s "
            f"an iteration, {one.waiting:.0%} of it in {one.reductions:.0f} reductions of {one.megabytes:.1f} MB; "
            f"{one.loopback:.1f} MB an iteration on the loopback interface"
        )
    several, own = best[max(ranks)], options.iteration_time or best[1].iteration
    rows = []
    if several.ranks > 1:
        print(f"calculated from {own:.2f} s an iteration of one machine and {options.latency:g} ms a message:")
        for megabits in options.megabits:
            for machines in options.machines:
                traffic = several.megabytes, several.reductions
                total, share = calculated(own, *traffic, machines, megabits, options.latency)
                minute = 2 * (machines - 1) / machines * several.megabytes * 60 / total
                rows.append({"megabits": megabits, "machines": machines, "iteration": total, "efficiency": share})
                print(
                    f"  {machines:4d} machines, {megabits:g} Mbit/s: {total:.2f} s an iteration, efficiency "
                    f"{share:.0%}, {machines * share:.1f} x one machine, each sends {minute:.0f} MB a minute"
                )
    if options.json:
        document = {"measured": [asdict(one) for one in best.values()], "calculated": rows}
        options.json.write_text(json.dumps(document, indent=2) + "\n")


if __name__ == "__main__":
    main()
