"""Programs in processes of their own, which tests stop and start again."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).parent


def start(program: str, root: Path, *arguments: str) -> subprocess.Popen[str]:
    """Start `python -m skatemount.<program>` beside a folder for runs, in a session of its own.

    It can import the modules of the tests, such as `holding`.
    """
    path = os.pathsep.join([str(HERE), os.environ.get("PYTHONPATH", "")])
    return subprocess.Popen(
        [sys.executable, "-m", f"skatemount.{program}", *arguments],
        cwd=root.parent, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        env=os.environ | {"PYTHONPATH": path},
    )  # fmt: skip


def wait_for(process: subprocess.Popen[str], root: Path, pattern: str, number: int = 1) -> None:
    """Wait until some paths below a folder match a pattern; fail if the process ends before."""
    while len(list(root.glob(pattern))) < number:
        assert process.poll() is None, process.communicate()[1]
        time.sleep(0.05)
