"""Trainings in forked processes, and the check of what they leave behind."""

from __future__ import annotations

import contextlib
import os
import random
import shutil
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

# One thread, or a fork would lose the others.
os.environ["OMP_NUM_THREADS"] = "1"
ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "tests" / "config")]

# Nothing is drawn.
os.environ.setdefault("MUJOCO_GL", "disable")

import torch  # noqa: E402

torch.set_num_threads(1)

from skatemount import train as program  # noqa: E402
from skatemount.config import from_dict  # noqa: E402
from skatemount.runs.checkpoint import list_checkpoints, load_policy, load_training_state, load_world_state  # noqa: E402
from skatemount.runs.folder import RunFolder  # noqa: E402
from skatemount.runs.metrics import read_metrics  # noqa: E402
from skatemount.training import callbacks  # noqa: E402
from skatemount.training.trainer import Trainer  # noqa: E402

BATCH = 8 * 8
SMALL = [
    "stage=balance",
    "physics.num_worlds=8",
    "collector.steps_per_env=8",
    "network.actor=[16]",
    "network.critic=[16]",
    "physics.threads=1",
    "torch_threads=1",
    "episode_length=0.4",
    "logger.checkpoint_every=1",
    "logger.evaluate_every=0",
    "logger.final_episodes=0",
    "logger.tensorboard=false",
    "logger.plot_every=1000",
]
FAILURES: list[str] = []


def forked(work: Callable[[], Any], log: Path, kill_after: float | None = None) -> int:
    """Run work in a forked process, and return its exit status; the negative number of a signal that killed it.

    Args:
        work: The work.
        log: File for its output.
        kill_after: Time after which SIGKILL ends it, s.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    child = os.fork()
    if not child:
        status = 1
        try:
            output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(output, 1)
            os.dup2(output, 2)
            sys.stdout, sys.stderr = (os.fdopen(n, "w", closefd=False) for n in (1, 2))
            work()
            status = 0
        except SystemExit as end:
            status = end.code if isinstance(end.code, int) else 1
        except BaseException as error:
            print(f"{type(error).__name__}: {error}", file=sys.stderr)
            status = 70
        finally:
            with contextlib.suppress(Exception):
                sys.stdout.flush()
                sys.stderr.flush()
            os._exit(status)
    if kill_after is not None:
        time.sleep(kill_after)
        os.kill(child, signal.SIGKILL)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def train(*arguments: str) -> None:
    """Run the program ``train``; its output and status are those of the command."""
    sys.argv = ["train", *arguments]
    program.main()


def resume(run: Path, frames: int) -> None:
    """Resume a run up to a number of frames, without the command line, which takes most of a short training's time."""
    config = from_dict(RunFolder.open(run).config, training=True)
    config.resume, config.total_frames = str(run), frames
    trainer = Trainer(config)
    trainer.train()
    trainer.close()


def without_pictures() -> None:
    """Draw no learning curves in this process, which would take half of the time."""
    callbacks.plot_learning_curves = lambda *arguments: None


def frames_of(run: Path) -> int:
    """Return the frames of the latest checkpoint of a run, 0 without one."""
    latest = RunFolder(run).latest
    return 0 if latest is None else int(load_training_state(latest)["progress"]["frames"])


def logged(run: Path) -> int:
    """Return the frames up to which a run has metrics."""
    file = RunFolder(run).metrics_file
    rows = read_metrics(file)["frames"] if file.is_file() else []
    return int(rows[-1]) if len(rows) else 0


def check(run: Path, log: Path, what: str) -> int:
    """Read every checkpoint of a run and resume it for two iterations; return the iterations that were lost.

    Args:
        run: The run.
        log: File for the output.
        what: The fault, for failures.
    """
    before, trained = frames_of(run), logged(run)
    try:
        for folder in list_checkpoints(run / "checkpoints"):
            load_policy(folder)
            load_training_state(folder)
            load_world_state(folder)
    except Exception as error:
        FAILURES.append(f"{what}: {type(error).__name__}: {error}")
        return 0
    if before:
        total = before + 2 * BATCH
        status = forked(lambda: (without_pictures(), resume(run, total)), log)
        if status or frames_of(run) != total:
            FAILURES.append(f"{what}: the resume ended with {status}: {log.read_text()[-300:]}")
        if left := [str(each) for each in run.rglob(".*.tmp")]:
            FAILURES.append(f"{what}: {left[0]} is left over")
    return max(0, trained - before) // BATCH


class Lab:
    """A folder for trials."""

    def __init__(self, folder: Path, times: int | None, seed: int) -> None:
        self.folder, self.times, self.random = folder, times, random.Random(seed)
        self.log = folder / "log.txt"

    def new(self, *arguments: str, name: str = "runs", status: int = 0) -> Path:
        """Train a new run, and return its folder."""
        root = self.folder / name
        shutil.rmtree(root, ignore_errors=True)
        found = forked(lambda: train(*SMALL, f"logger.root={root}", *arguments), self.log)
        if found != status:
            raise SystemExit(f"a training ended with {found}: {self.log.read_text()[-1000:]}")
        return self.run(name)

    def run(self, name: str = "runs") -> Path:
        """Return the folder of the only run."""
        (run,) = (path for path in (self.folder / name / "skatemount").iterdir() if path.is_dir())
        return run


def report(text: str) -> None:
    """Print how far it is."""
    print(text, file=sys.stderr, flush=True)


def row(fault: str, times: int, lost: list[int], words: str, **more: Any) -> dict[str, Any]:
    """Return a row of the table."""
    most = max(lost, default=0)
    return {
        "fault": fault,
        "times": times,
        "iterations_lost_most": most,
        "iterations_lost_mean": sum(lost) / len(lost) if lost else 0.0,
        "lost": "nothing that was complete" if most == 0 else f"at most {most} complete iteration" + "s" * (most > 1),
        "also_lost": words,
        **more,
    }
