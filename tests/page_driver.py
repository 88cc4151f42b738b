"""Runs commands of the docs, each in a fork of a process that has imported everything: that saves seconds for each.

Requests come as lines of JSON on the standard input, answers go to the standard output.
"""

from __future__ import annotations

import importlib
import json
import os
import runpy
import signal
import sys
import tempfile
import time
import traceback
from pathlib import Path
from typing import Any

PATIENCE = 600.0
"""Seconds after which a command is ended."""


def become(words: list[str], cwd: str) -> None:
    """Run a command in this process: `skatemount`, or `python` with `-m skatemount.<program>`, `-c` or a file."""
    os.chdir(cwd)
    sys.path.insert(0, cwd)
    if words[:2] == ["python", "-m"]:
        sys.argv = words[2:]
        importlib.import_module(words[2]).main()
    elif words[:2] == ["python", "-c"]:
        exec(compile(words[2], "<command>", "exec"), {"__name__": "__main__"})
    elif words[0] == "skatemount":
        sys.argv = words
        importlib.import_module("skatemount.__main__").main()
    else:
        sys.argv = words[1:]
        sys.path.insert(0, str(Path(words[1]).resolve().parent))
        runpy.run_path(words[1], run_name="__main__")


def run(words: list[str], cwd: str, interrupt_at: str) -> dict[str, Any]:
    """Run a command in a fork; return its status and its output.

    Args:
        words: The command.
        cwd: Working directory.
        interrupt_at: Text after which the command gets what Ctrl-C sends; none if empty.
    """
    with tempfile.NamedTemporaryFile() as log:
        child = os.fork()
        if not child:
            status = 0
            os.dup2(log.fileno(), 1)
            os.dup2(log.fileno(), 2)
            try:
                become(words, cwd)
            except SystemExit as error:
                status = error.code if isinstance(error.code, int) else 1 if error.code else 0
                if isinstance(error.code, str):
                    print(error.code, flush=True)
            except BaseException:
                traceback.print_exc()
                status = 1
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(status)
        end = time.monotonic() + PATIENCE
        while True:
            found, status = os.waitpid(child, os.WNOHANG)
            if found:
                break
            if interrupt_at and interrupt_at in Path(log.name).read_text(errors="replace"):
                os.kill(child, signal.SIGINT)
                interrupt_at = ""
            if time.monotonic() > end:
                os.kill(child, signal.SIGKILL)
            time.sleep(0.02)
        return {
            "status": os.waitstatus_to_exitcode(status),
            "printed": Path(log.name).read_text(encoding="utf-8", errors="replace"),
        }


def main() -> None:
    """Import what programs need, and answer requests until the input ends."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    for name in ("train", "evaluate", "record", "play", "report", "export", "runner.bench", "listing"):
        importlib.import_module(f"skatemount.{name}")
    # What these programs import only when they run.
    for name in ("training.trainer", "evaluation.evaluator", "agents.trained_policy", "viewer.session"):
        importlib.import_module(f"skatemount.{name}")
    for line in sys.stdin:
        print(json.dumps(run(**json.loads(line))), file=answers, flush=True)


if __name__ == "__main__":
    main()
