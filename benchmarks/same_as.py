"""Compare this version's numbers and training speed with another commit's, bit for bit and side by side.

    python benchmarks/same_as.py 5ce7322
    python benchmarks/same_as.py 5ce7322 --parts settings models --no-speed
    python benchmarks/same_as.py 5ce7322 --parts            only the timing

Both versions run on this machine, in turn, in the same environment: the other commit from a temporary checkout. What
is compared is listed in `tests/golden/golden_commands.py`. Names that have changed since are translated first, by the
table that also reads saved runs and policy cards. Where default physics has changed since, this version gets the
physics of commit 5ce7322. The script ends with status 1 if anything differs, or if training is slower than `--least`
times the other version's speed.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
GOLDEN = ROOT / "tests" / "golden"
# The code beside this script, and not an installed version.
sys.path[:0] = [str(ROOT), str(GOLDEN)]

import adapter  # noqa: E402
import golden_compare  # noqa: E402
from golden_commands import OLD, SPEED  # noqa: E402

PARTS = ("settings", "models", "steps", "updates", "policies", "episodes", "weights")


def main() -> None:
    """Dump both versions, compare, time."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("commit", help="the other version")
    parser.add_argument("--parts", nargs="*", choices=PARTS, default=PARTS, help="what to compare (default: all)")
    parser.add_argument("--no-speed", action="store_true", help="leave out the timing")
    parser.add_argument("--rounds", type=int, default=8, help="turns of each version's training (default 8)")
    parser.add_argument("--iterations", type=int, default=3, help="timed in each turn (default 3)")
    parser.add_argument("--least", type=float, default=0.98, help="ratio of speeds that is demanded (default 0.98)")
    options = parser.parse_args()
    failed = False
    with checkout(options.commit) as other, tempfile.TemporaryDirectory() as scratch:
        theirs, ours = Path(scratch) / "theirs", Path(scratch) / "ours"
        for part in options.parts:
            dump(other, adapter_of(other, options.commit), theirs, part)
            dump(ROOT, GOLDEN / "adapter.py", ours, part)
            differences = golden_compare.compare_folders(theirs, ours, part, adapter.translate)
            print(f"{part}: {'the same' if not differences else f'{len(differences)} differences'}", flush=True)
            for line in differences[:20]:
                print(f"  {line}")
            failed |= bool(differences)
        if not options.no_speed:
            ratio = speed_ratio(other, options.rounds, options.iterations)
            failed |= ratio < options.least
    sys.exit(int(failed))


@contextmanager
def checkout(commit: str) -> Iterator[Path]:
    """Give a temporary checkout of a commit."""
    archive = subprocess.run(["git", "-C", str(ROOT), "archive", commit], capture_output=True)
    if archive.returncode:
        sys.exit(f"{commit}: {archive.stderr.decode().strip()}")
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(["tar", "-x", "-C", folder], input=archive.stdout, check=True)
        yield Path(folder)


def adapter_of(tree: Path, commit: str) -> Path:
    """Return the adapter that fits a checkout: its own, or the frozen one of the time before there were any."""
    own = tree / "tests" / "golden" / "adapter.py"
    return own if own.is_file() else GOLDEN / f"adapter_{OLD}.py"


def dump(tree: Path, adapter: Path, out: Path, part: str) -> None:
    """Run `dump.py` of this checkout on the code of a tree."""
    command = [sys.executable, "-W", "ignore", str(GOLDEN / "dump.py"), str(adapter), str(out), part]
    done = subprocess.run(command, env=environment(tree), capture_output=True, text=True, cwd=tree)
    if done.returncode:
        sys.exit(f"{part} of {tree}:\n{done.stdout}\n{done.stderr}")


def environment(tree: Path) -> dict[str, str]:
    """Return the environment variables under which Python imports the code of a tree."""
    return os.environ | {"PYTHONPATH": str(tree), "MUJOCO_GL": "disable"}


def speed_ratio(other: Path, rounds: int, iterations: int) -> float:
    """Train with both versions in turn, and return the median over the rounds of their ratio of speeds, ours by theirs.

    Both trainings run all the time, but only one at once; the other one is stopped. So the two speeds of a round are
    measured within seconds of each other. The speed of a shared machine can change by a fifth in a minute.
    """
    ratios = []
    line = SPEED.format(frames=10**9)
    our_line = adapter.training_line(line)
    with paused_training(other, line) as theirs, paused_training(ROOT, our_line) as ours:
        for i in range(rounds):
            # The order alternates: a machine that slows down during a round must not favor one version.
            turns = [theirs, ours] if i % 2 == 0 else [ours, theirs]
            speeds = {training: training.speed(iterations) for training in turns}
            ratios.append(speeds[ours] / speeds[theirs])
            both = f"{speeds[ours]:,.0f} / {speeds[theirs]:,.0f} steps/s"
            print(f"  round {i + 1}: {both} = {ratios[-1]:.3f}", flush=True)
    print(f"training speed, median of {rounds} ratios: {statistics.median(ratios):.3f}")
    return statistics.median(ratios)


@contextmanager
def paused_training(tree: Path, line: str) -> Iterator[PausedTraining]:
    """Start a training with the code of a tree, stop it after its first two iterations, and end it with the block."""
    with tempfile.TemporaryDirectory() as folder:
        training = PausedTraining(tree, line, Path(folder))
        try:
            training.run(2)
            yield training
        finally:
            training.end()


class PausedTraining:
    """A training that is stopped (SIGSTOP) unless `run` or `speed` lets it go on.

    Args:
        tree: The code.
        line: Settings of the training.
        folder: For its run folder and its output.
    """

    def __init__(self, tree: Path, line: str, folder: Path):
        self._root, self._output = folder / "runs", folder / "output"
        command = [sys.executable, "-m", "skatemount.train", *line.split()]
        with self._output.open("w") as output:
            self._process = subprocess.Popen(
                [*command, f"logger.root={self._root}"],
                env=environment(tree),
                cwd=tree,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def run(self, iterations: int) -> list[float]:
        """Let the training go on for some iterations, and return their speeds, steps/s."""
        before = len(self._rates())
        os.killpg(self._process.pid, signal.SIGCONT)
        while len(done := self._rates()) < before + iterations:
            if self._process.poll() is not None:
                sys.exit(self._output.read_text())
            time.sleep(0.02)
        os.killpg(self._process.pid, signal.SIGSTOP)
        return done[before : before + iterations]

    def speed(self, iterations: int) -> float:
        """Run for some iterations and one before them, in which the training was stopped; return their mean speed."""
        return statistics.harmonic_mean(self.run(iterations + 1)[1:])

    def end(self) -> None:
        """End the training."""
        os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()

    def _rates(self) -> list[float]:
        return rates(self._root) if any(self._root.glob("*/*/metrics.*")) else []


def rates(root: Path) -> list[float]:
    """Return the speed of every iteration of the one run in a folder; an unfinished last line does not count."""
    (file,) = root.glob("*/*/metrics.*")
    lines = [line for line in file.read_text(encoding="utf-8").splitlines(keepends=True) if line.endswith("\n")]
    rows = map(json.loads, lines) if file.suffix == ".jsonl" else csv.DictReader(lines)
    return [float(row["Perf/total_fps"]) for row in rows]


if __name__ == "__main__":
    main()
