"""Compare this version's numbers and training speed with another commit's, bit for bit and side by side.

    python benchmarks/same_as.py 5ce7322
    python benchmarks/same_as.py 5ce7322 --parts settings models --no-speed

Both versions run on this machine, in turn, in the same environment: the other commit from a temporary checkout. What
is compared is listed in `tests/golden/golden_commands.py`. Names that have changed since are translated first, by the
table that also reads saved runs and policy cards. The script ends with status 1 if anything differs, or if training
is slower than `--least` times the other version's speed.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import statistics
import subprocess
import sys
import tempfile
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
ITERATION = 1024 * 24
"""Environment steps of one iteration of the training that is timed."""


def main() -> None:
    """Dump both versions, compare, time."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("commit", help="the other version")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS, help="what to compare (default: all)")
    parser.add_argument("--no-speed", action="store_true", help="leave out the timing")
    parser.add_argument("--rounds", type=int, default=5, help="timed trainings of each version, in turn (default 5)")
    parser.add_argument("--iterations", type=int, default=8, help="of each timed training (default 8)")
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
    """Train with both versions in turn, print their speeds, and return the ratio of the medians, ours by theirs."""
    speeds: dict[str, list[float]] = {"theirs": [], "ours": []}
    for i in range(rounds):
        # The order alternates: a machine that slows down during a round must not favor one version.
        order = [("theirs", other), ("ours", ROOT)]
        for name, tree in order if i % 2 == 0 else reversed(order):
            speeds[name].append(training_speed(tree, iterations))
            print(f"  round {i + 1}, {name}: {speeds[name][-1]:,.0f} steps/s", flush=True)
    theirs, ours = (statistics.median(speeds[name]) for name in ("theirs", "ours"))
    print(f"training speed, median of {rounds}: {ours:,.0f} / {theirs:,.0f} steps/s = {ours / theirs:.3f}")
    return ours / theirs


def training_speed(tree: Path, iterations: int) -> float:
    """Return the median speed of a training's iterations, all but the first two, in environment steps a second."""
    with tempfile.TemporaryDirectory() as root:
        line = SPEED.format(frames=iterations * ITERATION)
        command = [sys.executable, "-m", "skatemount.train", *line.split(), f"logger.root={root}"]
        done = subprocess.run(command, env=environment(tree), capture_output=True, text=True, cwd=tree)
        if done.returncode:
            sys.exit(f"{' '.join(command)}\n{done.stdout}\n{done.stderr}")
        return statistics.median(rates(Path(root))[2:])


def rates(root: Path) -> list[float]:
    """Return the speed of every iteration of the one run in a folder."""
    (file,) = root.glob("*/*/metrics.*")
    with file.open(encoding="utf-8") as lines:
        rows = map(json.loads, lines) if file.suffix == ".jsonl" else csv.DictReader(lines)
        return [float(row["Perf/total_fps"]) for row in rows]


if __name__ == "__main__":
    main()
