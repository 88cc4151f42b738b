"""The wheel in an environment that has numpy, mujoco and onnxruntime alone."""

from __future__ import annotations

import subprocess
import sys
import venv
from pathlib import Path

import exported
import numpy as np
import pytest
import runner_parity


def run(*words: object, cwd: Path) -> str:
    done = subprocess.run([str(word) for word in words], capture_output=True, text=True, cwd=cwd)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return done.stdout


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory, repo_root: Path) -> Path:
    """Python of a new environment with the wheel."""
    place = tmp_path_factory.mktemp("alone")
    run(sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", place / "wheel", cwd=repo_root)
    (wheel,) = (place / "wheel").iterdir()
    venv.create(place / "venv", with_pip=True)
    python = place / "venv" / "bin" / "python"
    pip = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    run(*pip, "-c", repo_root / "constraints.txt", "numpy", "mujoco", "onnxruntime", cwd=place)
    run(*pip, "--no-deps", wheel, cwd=place)
    return python


@pytest.mark.slow
@pytest.mark.parametrize("suite", ["stand", "pushed", "sensed", "walk"])
def test_every_control_step_is_that_of_the_torch_version(python: Path, suite: str, tmp_path: Path) -> None:
    np.savez(tmp_path / "recorded.npz", **exported.recording(suite))
    said = run(python, runner_parity.__file__, exported.folder(), suite, tmp_path / "recorded.npz", cwd=tmp_path)
    assert eval(said)["steps"] > 0


@pytest.mark.slow
def test_the_program_runs_there(python: Path, tmp_path: Path) -> None:
    said = run(python, "-m", "skatemount.runner", exported.folder(), "suite=all", cwd=tmp_path)
    assert said.count("success ") == len(exported.SUITES)
    assert run(python, "-c", "import importlib.util as u; print(u.find_spec('torch'))", cwd=tmp_path) == "None\n"
