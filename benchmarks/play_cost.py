"""Measure what the page of `play` costs: the program's share of a core, and pictures a second in a browser.

    python benchmarks/play_cost.py --seconds 20 checkpoint=pretrained:anywhere suite=approach-unfixed
    python benchmarks/play_cost.py --watch --seconds 60 --rounds 3 stage=balance physics.num_worlds=64

The program runs at the usual speed. Chromium opens its page, without a GPU, so it draws on the CPU. Then the processor
time of the program is measured, with and without the open page. Needs the extra `play`, playwright and Chromium.

`--watch` measures what `play watch=true` costs the training that it follows. One training runs all the time. Nothing
follows it, then the program without an open page, then with the page open in Chromium, and so on in turns. The steps a
second of a turn are compared with those of the turns without the program just before and after it. The training has one
thread. On a machine with more cores than the training, the program and the browser need, the ratio is 1.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import chromium  # noqa: E402

PICTURES = """() => new Promise(done => {
  let pictures = 0; const start = performance.now();
  const next = () => { pictures++;
    const passed = performance.now() - start;
    passed > 5000 ? done(1000 * pictures / passed) : requestAnimationFrame(next); };
  next(); })"""


def processor_time(process: subprocess.Popen[str]) -> float:
    """Return the processor time of a process and its threads, s."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / 100


def share(process: subprocess.Popen[str], seconds: float) -> float:
    """Return the share of a core that a process takes in the coming seconds."""
    before, start = processor_time(process), time.perf_counter()
    time.sleep(seconds)
    return (processor_time(process) - before) / (time.perf_counter() - start)


def measure(settings: list[str], worlds: int, seconds: float) -> dict[str, float]:
    """Return what a page with a number of worlds costs."""
    command = [sys.executable, "-m", "skatemount.play", f"worlds={worlds}", "open_browser=false", "plain=true"]
    process = subprocess.Popen([*command, *settings], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        address = next(found[0] for line in process.stdout if (found := re.search(r"http://\S+", line)))
        time.sleep(3)
        closed = share(process, seconds)
        with chromium.launched() as browser:
            page = browser.new_page(viewport={"width": 1180, "height": 700})
            page.goto(address)
            page.wait_for_selector("#play-time", timeout=120_000)
            time.sleep(5)
            begun, start = float(page.inner_text("#play-time").split()[0]), time.perf_counter()
            opened = share(process, seconds)
            simulated = float(page.inner_text("#play-time").split()[0]) - begun
            speed = simulated / (time.perf_counter() - start)
            pictures = float(page.evaluate(PICTURES))
    finally:
        end(process)
    return {"worlds": worlds, "closed": closed, "open": opened, "speed": speed, "pictures": pictures}


ALONE, CLOSED, OPEN = "no program", "no page open", "page open"
TRAINING = ["stage=balance", "physics.num_worlds=64"]
OFTEN = ["logger.checkpoint_every=5"]
"""The program waits for the first checkpoint, and then takes each new one."""
FIXED = ["torch_threads=1", "physics.threads=1", "logger.evaluate_every=0", "logger.final_episodes=0",
         "total_frames=1000000000", "logger.experiment=watched", "logger.name=watched"]  # fmt: skip
PATIENCE = 600.0
"""Seconds to wait for an iteration of the training, or for the page."""


@dataclass(frozen=True)
class Turn:
    """A part of the training's time.

    Attributes:
        kind: `ALONE`, `CLOSED` or `OPEN`.
        speed: Steps of the training in a second.
        program: Processor seconds of `play` in a second.
        browser: Those of Chromium.
    """

    kind: str
    speed: float
    program: float = 0.0
    browser: float = 0.0


def ratios(turns: Sequence[Turn]) -> dict[str, list[float]]:
    """Return the speed of each turn with the program, divided by the mean of its neighbors without it, by kind.

    Args:
        turns: In the order of time; the first and the last one are without the program.
    """
    found: dict[str, list[float]] = {}
    for i, turn in enumerate(turns):
        if turn.kind != ALONE:
            before = next(each for each in turns[i::-1] if each.kind == ALONE)
            after = next(each for each in turns[i:] if each.kind == ALONE)
            found.setdefault(turn.kind, []).append(turn.speed / ((before.speed + after.speed) / 2))
    return found


def watch_table(turns: Sequence[Turn]) -> str:
    """Return the table of `--watch`: medians over the turns of a kind, and the range of the ratio."""
    lines = ["| | steps/s | of those without the program | processor s of `play` in a second | of Chromium |"]
    lines.append("|---|---|---|---|---|")
    found = ratios(turns)
    for kind in dict.fromkeys(turn.kind for turn in turns):
        of_kind = [turn for turn in turns if turn.kind == kind]
        speed, program, browser = (
            statistics.median(getattr(turn, name) for turn in of_kind) for name in ("speed", "program", "browser")
        )
        ratio, used = "1", "- | -"
        if kind != ALONE:
            values = found[kind]
            ratio = f"{statistics.median(values):.3f} ({min(values):.3f} to {max(values):.3f})"
            used = f"{program:.2f} | {browser:.2f}"
        lines.append(f"| {kind} | {speed:.0f} | {ratio} | {used} |")
    return "\n".join(lines)


def descendants(process: int) -> set[int]:
    """Return a process and all that it has started, by their ids."""
    parents = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            parents[int(stat.parent.name)] = int(stat.read_text().rsplit(")", 1)[1].split()[1])
        except OSError:
            continue  # it has just ended
    found, new = set(), {process}
    while new:
        found |= new
        new = {child for child, parent in parents.items() if parent in new} - found
    return found


def processor_times(processes: set[int]) -> float:
    """Return the processor time of processes, s; those that have ended count nothing."""
    total = 0.0
    for each in processes:
        try:
            fields = Path(f"/proc/{each}/stat").read_text().rsplit(")", 1)[1].split()
        except OSError:
            continue
        total += (int(fields[11]) + int(fields[12])) / 100
    return total


def end(process: subprocess.Popen[str]) -> None:
    """End a process: politely, or by force after a minute, as on a machine that has other work."""
    process.terminate()
    try:
        process.wait(60)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


class Training:
    """A training in a process of its own.

    Args:
        root: Folder of its run.
        settings: Its settings.
    """

    def __init__(self, root: Path, settings: Sequence[str]):
        self._log = root / "training.log"
        command = [sys.executable, "-m", "skatemount.train", *OFTEN, *settings, *FIXED, f"logger.root={root}"]
        with self._log.open("w") as file:
            self.process = subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT, text=True)
        self._root = root

    def _frames(self) -> int:
        lines = [line for file in self._root.glob("*/*/metrics.jsonl") for line in file.read_text().splitlines()]
        return int(json.loads(lines[-1])["frames"]) if lines else 0

    def iteration(self) -> tuple[float, int]:
        """Wait for the end of an iteration, and return the time, s, and the steps so far.

        Raises:
            RuntimeError: The training has ended, or takes too long.
        """
        before, end = self._frames(), time.monotonic() + PATIENCE
        while (frames := self._frames()) == before:
            if self.process.poll() is not None:
                raise RuntimeError(f"the training ended: {self._log.read_text()[-500:]}")
            if time.monotonic() > end:
                raise RuntimeError(f"the training made no iteration within {PATIENCE:g} s")
            time.sleep(0.02)
        return time.perf_counter(), frames

    def turn(self, kind: str, seconds: float, program: set[int], browser: set[int]) -> Turn:
        """Measure for some seconds, from the end of an iteration to that of another.

        Args:
            kind: Kind of the turn.
            seconds: Least length.
            program: Processes of `play`.
            browser: Processes of Chromium.
        """
        began, frames = self.iteration()
        used = processor_times(program), processor_times(browser)
        time.sleep(seconds)
        ended, more = self.iteration()
        passed = ended - began
        shares = [(processor_times(of) - before) / passed for of, before in zip((program, browser), used, strict=True)]
        return Turn(kind, (more - frames) / passed, *shares)

    def end(self) -> None:
        """End the training."""
        end(self.process)


def measure_watching(settings: Sequence[str], seconds: float, rounds: int) -> list[Turn]:
    """Return the turns of a training without `play watch=true`, with it, and with its page open.

    Args:
        settings: Settings of the training.
        seconds: Least length of a turn.
        rounds: Times that each kind is measured.
    """
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        training = Training(root, settings)
        try:
            training.iteration()
            turns = []
            for _ in range(rounds):
                turns.append(training.turn(ALONE, seconds, set(), set()))
                turns += _watched(training, root, seconds)
            turns.append(training.turn(ALONE, seconds, set(), set()))
        finally:
            training.end()
    return turns


def _watched(training: Training, root: Path, seconds: float) -> list[Turn]:
    """Return a turn with the program alone, and one with its page in Chromium."""
    command = [sys.executable, "-m", "skatemount.play", "run=latest", "watch=true", f"logger.root={root}"]
    others = descendants(os.getpid())
    process = subprocess.Popen(
        [*command, "open_browser=false", "plain=true"], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    assert process.stdout is not None
    try:
        address = next((found[0] for line in process.stdout if (found := re.search(r"http://\S+", line))), None)
        if address is None:
            raise RuntimeError("play ended before it printed an address")
        program = descendants(process.pid)
        turns = [training.turn(CLOSED, seconds, program, set())]
        with chromium.launched() as browser:
            page = browser.new_page(viewport={"width": 1180, "height": 700})
            page.goto(address)
            page.wait_for_selector("#play-time", timeout=1000 * PATIENCE)
            time.sleep(5)  # until everything is drawn
            program = descendants(process.pid)
            drawing = descendants(os.getpid()) - others - program
            turns.append(training.turn(OPEN, seconds, program, drawing))
    finally:
        end(process)
    return turns


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--worlds", type=int, nargs="+", default=[1, 4])
    parser.add_argument("--seconds", type=float, default=20.0, help="length of each measurement")
    parser.add_argument("--json", type=Path, help="file for the numbers")
    parser.add_argument("--watch", action="store_true", help="measure what play watch=true costs a training")
    parser.add_argument("--rounds", type=int, default=3, help="turns of each kind, with --watch")
    parser.add_argument("settings", nargs="*", help="of play; with --watch, of the training")
    options = parser.parse_intermixed_args()
    if options.watch:
        # What it started ends with it.
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
        turns = measure_watching(options.settings or TRAINING, options.seconds, options.rounds)
        print(watch_table(turns))
        if options.json is not None:
            options.json.write_text(json.dumps([asdict(turn) for turn in turns], indent=2) + "\n", encoding="utf-8")
        return
    options.settings = options.settings or ["checkpoint=pretrained:anywhere", "suite=approach-unfixed"]
    rows = [measure(options.settings, worlds, options.seconds) for worlds in options.worlds]
    print("| worlds | share of a core, no page open | page open | simulated s in a second | pictures a second |")
    print("|---|---|---|---|---|")
    for row in rows:
        shares = f"{row['closed']:.2f} | {row['open']:.2f} | {row['speed']:.2f}"
        print(f"| {row['worlds']} | {shares} | {row['pictures']:.1f} |")
    if options.json is not None:
        options.json.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
