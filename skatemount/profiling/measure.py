"""Speed measurements, each point of a sweep in a process of its own."""

from __future__ import annotations

import concurrent.futures
import copy
import multiprocessing
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from skatemount.config import BenchProgramConfig
from skatemount.profiling.stopwatch import COLLECTING, LEARNING, profile_trainer
from skatemount.profiling.workload import BenchWorkload
from skatemount.runs.provenance import package_versions
from skatemount.training.trainer import Trainer
from skatemount.utils.cores import available_cores
from skatemount.utils.devices import choose_device
from skatemount.utils.quiet import ignore_library_warnings

FIGURES = ("raw", "env", "collect", "learn", "train")
"""Steps per second of: physics alone, the environment, collecting (with the policy), learning, the whole training."""


@dataclass
class Point:
    """Measurements with one number of worlds and threads.

    Attributes:
        worlds: Number of worlds.
        threads: Number of threads of physics and of torch.
        rates: Steps per second by `FIGURES`.
        memory: Bytes that the training took; none if the system does not report it.
        profile: Share of an iteration's time by part; empty if it was not measured.
    """

    worlds: int
    threads: int
    rates: dict[str, float]
    memory: int | None = None
    profile: dict[str, float] = field(default_factory=dict)

    def of_raw(self) -> dict[str, float]:
        """Return every rate but the first as a fraction of raw physics."""
        return {name: rate / self.rates["raw"] for name, rate in self.rates.items() if name != "raw"}

    def to_dict(self) -> dict[str, Any]:
        """Return the measurements as plain values."""
        values: dict[str, Any] = {"worlds": self.worlds, "threads": self.threads, **self.rates}
        values |= {f"{name}_of_raw": share for name, share in self.of_raw().items()}
        if self.memory is not None:
            values["memory_bytes"] = self.memory
        return values


@dataclass
class Measured:
    """All measurements of one `bench`.

    Attributes:
        title: Name of the training.
        machine: Description of the machine.
        main: Measurements with the given settings.
        by_worlds: Measurements with other numbers of worlds.
        by_threads: Measurements with other numbers of threads.
        start_s: Seconds from the training command to the end of its first iteration.
    """

    title: str
    machine: str
    main: Point
    by_worlds: list[Point] = field(default_factory=list)
    by_threads: list[Point] = field(default_factory=list)
    start_s: float | None = None

    def bytes_per_world(self) -> float | None:
        """Return the memory of one more world: the slope between the least and the most worlds."""
        known = [point for point in self.by_worlds if point.memory is not None]
        if len(known) < 2:
            return None
        least, most = (pick(known, key=lambda point: point.worlds) for pick in (min, max))
        if least.worlds == most.worlds:
            return None
        return ((most.memory or 0) - (least.memory or 0)) / (most.worlds - least.worlds)

    def to_dict(self) -> dict[str, Any]:
        """Return the measurements as plain values, those of `main` at the top level."""
        return {
            **self.main.to_dict(),
            "title": self.title,
            "machine": self.machine,
            "profile": self.main.profile,
            "by_worlds": [point.to_dict() for point in self.by_worlds],
            "by_threads": [point.to_dict() for point in self.by_threads],
            "bytes_per_world": self.bytes_per_world(),
            "first_iteration_s": self.start_s,
            "versions": package_versions(),
        }


def measure(config: BenchProgramConfig, overrides: list[str], report: Callable[[str], None]) -> Measured:
    """Measure everything that the settings ask for.

    Args:
        config: Settings of the training, and ``bench``.
        overrides: The command line's overrides, for the training command.
        report: Called with a description of the next measurement.
    """
    bench, worlds = config.bench, config.physics.num_worlds
    threads = config.physics.threads or available_cores()

    def point(worlds: int, threads: int, profile: bool = False) -> Point:
        report(f"{worlds} worlds, {threads} thread{'s' if threads > 1 else ''}")
        changed = copy.deepcopy(config)
        changed.physics.num_worlds, changed.physics.threads, changed.torch_threads = worlds, threads, threads
        return in_fresh_process(measure_point, changed, profile)

    title = f"{config.stage.name or 'the default task'}, {worlds} worlds, actor {list(config.network.actor)}"
    result = Measured(title, machine(), point(worlds, threads, bench.profile))
    result.by_worlds = [point(each, threads) for each in bench.worlds]
    result.by_threads = [point(worlds, each) for each in bench.threads]
    if bench.start:
        report("the training command, until its first iteration")
        result.start_s = time_to_first_iteration(overrides)
    return result


def in_fresh_process(work: Callable[..., Any], *arguments: Any) -> Any:
    """Return a function's result from a new process: memory of its own, and not warmed up by earlier measurements."""
    spawn = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(1, mp_context=spawn, initializer=ignore_library_warnings) as pool:
        return pool.submit(work, *arguments).result()


def measure_point(config: BenchProgramConfig, profile: bool = False) -> Point:
    """Measure one training, in this process.

    Args:
        config: Settings of the training, and ``bench``.
        profile: Measure the share of each part as well.
    """
    bench, physics = config.bench, config.physics
    device = choose_device("cpu" if physics.engine == "cpu" else physics.device)
    with tempfile.TemporaryDirectory() as folder:
        config.logger.root = folder
        before = memory_taken(device)
        workload = BenchWorkload(Trainer(config.training))
        try:
            after = memory_taken(device)
            # All rounds count: a shared machine has fast moments, and the best of each would compare one with another.
            done, took = dict.fromkeys(FIGURES, 0), dict.fromkeys(FIGURES, 0.0)
            for _ in range(bench.rounds):
                timed = {"raw": workload.raw(bench.seconds), "env": workload.env(bench.seconds)}
                for name, (steps, spent) in (timed | workload.training(bench.seconds)).items():
                    done[name] += steps
                    took[name] += spent
            rates = {name: done[name] / took[name] for name in FIGURES}
            shares = profiled(workload, bench.seconds) if profile else {}
        finally:
            workload.close()
    memory = None if before is None or after is None else after - before
    return Point(physics.num_worlds, physics.threads, rates, memory, shares)


def profiled(workload: BenchWorkload, seconds: float) -> dict[str, float]:
    """Return the share of each part in the training's time, and of the rest of collecting and learning."""
    with profile_trainer(workload.trainer) as stopwatch:
        timed = workload.training(seconds)
    spent = stopwatch.spent
    collect, learn, whole = (timed[name][1] for name in ("collect", "learn", "train"))
    parts = {name: spent.get(name, 0.0) for name in COLLECTING}
    parts["rest of collecting"] = collect - sum(parts.values())
    parts |= {name: spent.get(name, 0.0) for name in LEARNING}
    parts["rest of learning"] = learn - sum(parts[name] for name in LEARNING)
    parts["between"] = whole - collect - learn
    return {name: took / whole for name, took in parts.items()}


def time_to_first_iteration(overrides: list[str]) -> float | None:
    """Return the seconds from the training command until its first iteration is done; none if it ended without one.

    Args:
        overrides: Settings of the training.
    """
    with tempfile.TemporaryDirectory() as folder:
        words = [sys.executable, "-m", "skatemount.train", *overrides, "total_frames=1", f"logger.root={folder}"]
        start = time.monotonic()
        process = subprocess.Popen(
            [*words, "logger.evaluate_every=0", "logger.final_episodes=0"], stdout=subprocess.PIPE, text=True
        )
        assert process.stdout is not None
        took = next((time.monotonic() - start for line in process.stdout if "steps/s" in line), None)
        process.communicate()
    return took


def machine() -> str:
    """Return the processor's name, the number of usable cores, and the GPU's name if there is one."""
    name = platform.processor() or platform.machine()
    if Path("/proc/cpuinfo").is_file():
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        name = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), name)
    parts = [f"{name}, {available_cores()} cores"]
    if torch.cuda.is_available():
        parts.append(torch.cuda.get_device_name())
    return ", ".join(parts)


def memory_taken(device: torch.device) -> int | None:
    """Return the peak memory of this process, or the used memory of a GPU, bytes; none if the system tells neither."""
    if device.type == "cuda":
        free, total = torch.cuda.mem_get_info(device)
        return total - free
    try:
        import resource
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024
