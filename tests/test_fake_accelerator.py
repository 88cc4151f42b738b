"""No operation of a training mixes tensors of its device with tensors of the CPU; tested without a GPU."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from torch.utils import backend_registration

HERE = Path(__file__).parent


@pytest.mark.skipif(
    not hasattr(backend_registration, "_setup_privateuseone_for_python_backend"), reason="torch is too old for it"
)
def test_a_training_mixes_no_tensors_of_two_devices(tmp_path: Path, repo_root: Path) -> None:
    words = [sys.executable, "-W", "ignore", str(HERE / "fake_accelerator.py"), str(tmp_path)]
    path = os.pathsep.join([str(repo_root), os.environ.get("PYTHONPATH", "")])
    result = subprocess.run(words, capture_output=True, text=True, timeout=600, env={**os.environ, "PYTHONPATH": path})
    assert result.returncode == 0, result.stderr[-3000:]
