"""Requests to end at every moment of a training."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from typing import Any

from trials.process import (
    BATCH,
    FAILURES,
    ROOT,
    SMALL,
    Lab,
    forked,
    frames_of,
    logged,
    report,
    row,
    train,
    without_pictures,
)

from skatemount import cli
from skatemount.envs import MountEnv
from skatemount.evaluation.evaluator import Evaluator
from skatemount.losses.ppo import PPO
from skatemount.runs import checkpoint

SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP", "SIGUSR1")
MOMENTS = ("import", "composing", "first iteration", "rollout", "update", "save", "evaluation", "final evaluation")


def at_moment(moment: str, signum: int, twice: bool) -> None:
    """Let a signal, or two, come in at a moment of the training that follows in this process."""
    seen = {"steps": 0, "updates": 0, "saves": 0, "rounds": 0, "second": False}

    def come() -> None:
        if twice and moment in ("composing", "first iteration"):
            # There is nothing to save, so that the second one comes at once.
            try:
                signal.raise_signal(signum)
            finally:
                signal.raise_signal(signum)
        seen["second"] = twice
        signal.raise_signal(signum)

    def wrapped(owner: Any, name: str, before: Callable[[], None]) -> None:
        real = getattr(owner, name)

        def wrapper(*arguments: Any, **options: Any) -> Any:
            before()
            return real(*arguments, **options)

        setattr(owner, name, wrapper)

    def counted(key: str, number: int) -> Callable[[], None]:
        def before() -> None:
            seen[key] += 1
            if seen[key] == number:
                come()

        return before

    def second() -> None:
        if seen["second"]:
            seen["second"] = False
            signal.raise_signal(signum)

    if moment == "composing":
        wrapped(cli, "plain", come)
    elif moment in ("first iteration", "rollout"):
        wrapped(MountEnv, "_step", counted("steps", 4 if moment == "first iteration" else 3 * 8 + 5))
    elif moment == "update":
        wrapped(PPO, "_step", counted("updates", 30))
    elif moment == "save":
        wrapped(checkpoint, "save_policy", counted("saves", 3))
    else:
        wrapped(Evaluator, "round", counted("rounds", 1 if moment == "evaluation" else 3))
    # The second signal comes while files are written.
    wrapped(os, "fsync", second)


def signalled(lab: Lab, moment: str, name: str, twice: bool) -> int:
    """Try one signal at one moment, and return the complete iterations that were lost."""
    what = f"{name} {'twice ' if twice else ''}at: {moment}"
    root, signum = lab.folder / "signals", getattr(signal, name)
    shutil.rmtree(root, ignore_errors=True)
    settings = [*SMALL, f"logger.root={root}", f"total_frames={6 * BATCH}", "logger.checkpoint_every=2"]
    settings += ["logger.evaluate_every=3", "logger.evaluate_episodes=4", "logger.final_episodes=4"]
    if moment == "import":
        code = (
            f"import signal, sys\nsent = []\ndef hook(event, arguments):\n"
            f"    if event == 'import' and arguments[0] == 'omegaconf' and not sent:\n        sent.append(1)\n"
            f"        try:\n            signal.raise_signal({signum:d})\n        finally:\n"
            f"            {f'signal.raise_signal({signum:d})' if twice else 'pass'}\n"
            f"sys.argv = {['train', *settings]!r}\nfrom skatemount import train\nsys.addaudithook(hook)\ntrain.main()"
        )
        done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
        status, said = done.returncode, done.stderr
    else:

        def work() -> None:
            without_pictures()
            at_moment(moment, signum, twice)
            train(*settings)

        status = forked(work, lab.log)
        said = lab.log.read_text()
    if status != 128 + signum or f"ended by {name}" not in said:
        FAILURES.append(f"{what}: ended with {status}: {said[-400:]}")
    runs = [run for run in (root / "skatemount").glob("*") if run.is_dir()] if root.is_dir() else []
    complete = logged(runs[0]) if runs else 0
    if not complete:
        return 0
    run = runs[0]
    saved = frames_of(run)
    command = re.search(r"go on with: (python -m skatemount\.\w+ .*)", said)
    if command is None:
        FAILURES.append(f"{what}: names no command: {said[-400:]}")
        return (complete - saved) // BATCH
    _, _, module, *arguments = shlex.split(command[1])
    if module == "skatemount.evaluate":
        arguments += ["episodes=4"]
    target = {"skatemount.train": train, "skatemount.evaluate": evaluate}[module]
    status = forked(lambda: (without_pictures(), target(*arguments)), lab.log)
    if status or frames_of(run) != 6 * BATCH:
        FAILURES.append(f"{what}: {command[1]} ended with {status}: {lab.log.read_text()[-400:]}")
    return (complete - saved) // BATCH


def evaluate(*arguments: str) -> None:
    """Run the program ``evaluate``."""
    from skatemount import evaluate as module

    sys.argv = ["evaluate", *arguments]
    module.main()


def signals(lab: Lab) -> dict[str, Any]:
    """Send each signal at each moment, once and twice."""
    cases = [(m, name, twice) for m in MOMENTS for name in SIGNALS for twice in (False, True)]
    if lab.times is not None and lab.times < len(cases):
        cases = lab.random.sample(cases, lab.times)
    lost = []
    for n, (moment, name, twice) in enumerate(cases):
        lost.append(signalled(lab, moment, name, twice))
        if n % 8 == 7:
            report(f"signals: {n + 1} of {len(cases)}")
    return row("4 signals × 8 moments × once and twice", len(cases), lost, "the iteration that was running")
