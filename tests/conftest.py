"""Shared by all tests: headless rendering, few threads, a place for runs."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from ctypes.util import find_library
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from skatemount.envs import MountEnv

# Decided before anything imports mujoco or dm_control, which read it once. Without a GL library
# the backend is left to them: only tests that render need one.
if sys.platform.startswith("linux") and "MUJOCO_GL" not in os.environ:
    for backend, library in (("egl", "EGL"), ("osmesa", "OSMesa")):
        if find_library(library):
            os.environ["MUJOCO_GL"] = backend
            break
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "agg")

import torch  # noqa: E402

torch.set_num_threads(1)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skips the tests marked `gpu` where there is no CUDA device."""
    if torch.cuda.is_available():
        return
    no_gpu = pytest.mark.skip(reason="needs a CUDA device")
    for item in items:
        if item.get_closest_marker("gpu"):
            item.add_marker(no_gpu)


def pytest_collection_finish() -> None:
    """Keeps what all tests have imported out of the garbage collector, which else walks half a million objects."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def repo_root() -> Path:
    """The top of the clone."""
    return Path(__file__).resolve().parents[1]


@pytest.fixture
def runs_root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder for runs; the working directory is its parent."""
    monkeypatch.chdir(tmp_path)
    root = tmp_path / "runs"
    root.mkdir()
    return root


@pytest.fixture
def call_program(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], runs_root: Path
) -> Callable[..., tuple[Any, str, str]]:
    """Calls `verb` as a program with arguments, `call_program(verb, program, *arguments)`, in this process.

    Returns its exit status, output and error output.
    """
    from skatemount import cli
    from skatemount.utils.signals import exiting_by_signals

    monkeypatch.setenv("HYDRA_FULL_ERROR", "0")  # as Hydra sets it itself

    def call(verb: Callable[..., Any], program: str, *arguments: str) -> tuple[Any, str, str]:
        monkeypatch.setattr(sys, "argv", [program, *arguments])
        status: Any = 0
        try:
            with exiting_by_signals(program):
                cli.run(verb, program)
        except SystemExit as error:
            status = error.code
        out, err = capfd.readouterr()
        return status, out, err

    return call


@pytest.fixture
def fresh_workers() -> None:
    """No worker processes of joblib; those of an earlier test would have its working directory."""
    pytest.importorskip("hydra_plugins.hydra_joblib_launcher")
    from joblib.externals.loky import get_reusable_executor

    get_reusable_executor().shutdown(wait=True)


AT_FIRST = torch.get_float32_matmul_precision(), torch.get_num_threads()
"""Precision and threads of torch before anything was trained."""


@pytest.fixture(autouse=True)
def torch_as_it_was() -> None:
    """Undo what an earlier test or fixture has trained: it sets torch's precision and threads for the whole process.

    On a processor that multiplies in bfloat16, such a precision changes the numbers of this test.
    """
    precision, threads = AT_FIRST
    torch.set_float32_matmul_precision(precision)
    torch.set_num_threads(threads)


@pytest.fixture
def no_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Trainings draw no learning curves, which takes longer than a tiny training."""
    from skatemount.training import callbacks

    monkeypatch.setattr(callbacks, "plot_learning_curves", lambda *arguments: None)


@pytest.fixture
def make_env() -> Iterator[Callable[..., MountEnv]]:
    """A batched environment, `make_env(stage, num_worlds, overrides, **arguments of MountEnv)`; closed at the end."""
    from skatemount.envs import MountEnv, MountTask

    made: list[MountEnv] = []

    def make(stage: str = "mount", num_worlds: int = 4, overrides: Sequence[str] = (), **arguments: Any) -> MountEnv:
        arguments = {"threads": 1} | arguments
        made.append(MountEnv(MountTask(stage=stage, overrides=overrides), num_worlds=num_worlds, **arguments))
        return made[-1]

    yield make
    for env in made:
        env.close(raise_if_closed=False)
