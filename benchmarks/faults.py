"""Try faults on small trainings, and count what each of them cost.

    python benchmarks/faults.py
    python benchmarks/faults.py --only kills signals --times 3
    python benchmarks/faults.py --json docs/results/faults.json

Every trial runs in a process of its own, which is forked after the imports. It is killed, gets signals, a full disk or
numbers that are not finite; then all checkpoints of the run are read, and the run is resumed. What cannot be read or
resumed counts as a failure. Lost are the complete iterations that no checkpoint holds.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))

import torch  # noqa: E402
from trials.process import (  # noqa: E402
    BATCH,
    FAILURES,
    ROOT,
    SMALL,
    Lab,
    check,
    forked,
    frames_of,
    report,
    resume,
    row,
    without_pictures,
)
from trials.signals import signals  # noqa: E402
from trials.storage import full, operations  # noqa: E402

from skatemount.agents.trained_policy import TrainedPolicy  # noqa: E402
from skatemount.config import compose  # noqa: E402
from skatemount.runs.folder import RunFolder  # noqa: E402
from skatemount.runs.metrics import read_metrics  # noqa: E402
from skatemount.runs.provenance import package_versions  # noqa: E402
from skatemount.training.callbacks import Callback  # noqa: E402
from skatemount.training.trainer import Trainer  # noqa: E402


def kills(lab: Lab) -> dict[str, Any]:
    """Kill a training at random moments, resume it, and kill it again."""
    run, times, lost = lab.new(f"total_frames={BATCH}"), lab.times or 100, []
    begun = time.monotonic()
    forked(lambda: (without_pictures(), resume(run, 12 * BATCH)), lab.log)
    longest = time.monotonic() - begun
    for n in range(times):
        forked(lambda: resume(run, 10**6 * BATCH), lab.log, lab.random.uniform(0, longest))
        lost.append(check(run, lab.log, f"kill {n + 1}"))
        if n % 10 == 9:
            report(f"kills: {n + 1} of {times}, {frames_of(run) // BATCH} iterations")
    return row("SIGKILL at a random moment", times, lost, "the iteration that was running")


def refused(lab: Lab) -> dict[str, Any]:
    """Count the refused inputs of the tests' table, through the tests' own checks."""
    code = "import sys, pytest; sys.exit(pytest.main(sys.argv[1:]))"
    options = ["-q", "-p", "no:cacheprovider", str(ROOT / "tests/config/test_refused.py")]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", code, *options], cwd=ROOT, env=environment, capture_output=True, text=True
    )
    if done.returncode:
        FAILURES.append(f"refused inputs: {done.stdout[-600:]}")
    import test_refused as table

    cases = [(kind, case) for kind, *case in table._numbers()]
    cases += [(kind, each) for kind, listed in table.LISTED.items() for each in listed]
    for kind in ("PARAMETERS", "TOGETHER", "SIZES", "SUITES", "SAVED", "PROGRAMS"):
        cases += [(kind, each) for each in getattr(table, kind)]
    kinds = len({kind for kind, _ in cases})
    return row("settings that are nonsense", len(cases), [], "nothing: each is refused in one line", kinds=kinds)


class Spoiled(Callback):
    """Puts nan into one place of the third iteration."""

    def __init__(self, place: str) -> None:
        self.place = place

    def on_batch_collected(self, trainer: Trainer, batch: Any) -> None:
        """Spoil the batch, or what learns from it."""
        here = trainer.iteration == 2
        parameter = next(iter(trainer.networks.parameters()))
        if self.place == "physics" and trainer.iteration == 1:
            trainer.env.physics._qpos[3, 0] = math.nan  # type: ignore[attr-defined]
        elif self.place in ("action", "reward") and here:
            batch["action" if self.place == "action" else ("next", "reward")][3, 2] = math.nan
        elif self.place == "loss" and here:
            algorithm: Any = trainer.algorithm
            real = algorithm.loss
            algorithm.loss = lambda part: {"loss_objective": real(part)["loss_objective"] * math.nan}
            self.restore = lambda: setattr(algorithm, "loss", real)
        elif self.place == "gradient":
            for handle in getattr(self, "handles", []):
                handle.remove()
            self.handles = [parameter.register_hook(lambda grad: grad * math.nan)] if here else []
        elif self.place == "parameter" and here:
            with torch.no_grad():
                parameter.view(-1)[0] = math.nan
        if self.place == "loss" and trainer.iteration == 3:
            self.restore()


def numbers(lab: Lab) -> list[dict[str, Any]]:
    """Put nan into six places, one after the other."""
    rows = []
    for place in ("physics", "action", "reward", "loss", "gradient", "parameter"):
        root = lab.folder / "numbers"
        shutil.rmtree(root, ignore_errors=True)
        given = [*SMALL, f"logger.root={root}", f"total_frames={6 * BATCH}"]

        def work(place: str = place, given: list[str] = given) -> None:
            trainer = Trainer(compose(None, given), given, callbacks=[Spoiled(place)])
            trainer.train()
            trainer.close()

        status, said = forked(work, lab.log), lab.log.read_text()
        run = lab.run("numbers")
        table = read_metrics(RunFolder(run).metrics_file)
        undone = int(table["Train/undone_updates"][-1])
        finite = all(bool(v.isfinite().all()) for v in TrainedPolicy.load(str(run)).networks.state_dict().values())
        if status or frames_of(run) != 6 * BATCH or not finite or undone != (place != "physics"):
            FAILURES.append(f"nan in {place}: ended with {status}, {undone} updates undone: {said[-400:]}")
        named = re.search(r"steps is undone: (.*)", said)
        words = named[1] if named else "world diverged, which ends its episode"
        lost = "an update" if undone else "an episode of one world"
        rows.append(row(f"nan in {place}", 1, [], words) | {"lost": lost, "named": words})
        check(run, lab.log, f"nan in {place}")
    return rows


KINDS: dict[str, Callable[[Lab], Any]] = {
    "kills": kills, "operations": operations, "signals": signals, "full": full, "refused": refused, "numbers": numbers,
}  # fmt: skip


def main() -> None:
    """Try the faults, print the table, and write it on request; the status is 1 if something failed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=list(KINDS), default=list(KINDS), help="kinds of faults")
    parser.add_argument("--times", type=int, help="trials of each kind, at most; all, and 100 kills, by default")
    parser.add_argument("--seed", type=int, default=0, help="of the random moments")
    parser.add_argument("--json", type=Path, help="file for the table; rows of other kinds stay")
    options = parser.parse_args()
    rows: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        for kind in options.only:
            begun = time.monotonic()
            found = KINDS[kind](Lab(Path(folder), options.times, options.seed))
            rows[kind] = found if isinstance(found, list) else [found]
            report(f"{kind}: {time.monotonic() - begun:.0f} s, {len(FAILURES)} failures so far")
    for each in (each for found in rows.values() for each in found):
        print(f"{each['fault']}: {each['times']} times; lost: {each['lost']}; {each['also_lost']}")
    for failure in FAILURES:
        print(f"FAILED {failure}", file=sys.stderr)
    if options.json and not FAILURES:
        write(options.json, rows)
    sys.exit(1 if FAILURES else 0)


def write(path: Path, rows: dict[str, Any]) -> None:
    """Write rows by kind into a results file, beside those of other kinds."""
    document = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {"format": 1}
    words = ["git", "rev-parse", "--short=7", "HEAD"]
    commit = subprocess.run(words, cwd=ROOT, capture_output=True, text=True).stdout.strip()
    about = {"command": "python benchmarks/faults.py", "commit": commit, "versions": package_versions()}
    document |= about | {"faults": document.get("faults", {}) | rows}
    path.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
