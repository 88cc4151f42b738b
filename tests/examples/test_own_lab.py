"""The example of a lab with its own stage, board, suite and terms, used as its README says."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from tiny import TINY

README_COMMAND = re.compile(r"^    skatemount (.+)$", re.MULTILINE)
EXTRA = {
    "train": [*TINY, "total_frames=64"],
    "resume": ["total_frames=96"],
    "evaluate": ["episodes=4", "physics.num_worlds=4", "physics.threads=1", "episode_length=1.0", "json=result.json"],
    "list": [],
}
"""Tiny settings for each command of the README."""


@pytest.fixture
def lab(repo_root: Path, tmp_path: Path) -> Path:
    """A copy of the example, outside of the clone."""
    return Path(shutil.copytree(repo_root / "examples" / "own_lab", tmp_path / "lab"))


@pytest.fixture
def run(repo_root: Path, lab: Path) -> Callable[..., subprocess.CompletedProcess[str]]:
    def call(*words: str) -> subprocess.CompletedProcess[str]:
        environment = os.environ | {"PYTHONPATH": str(repo_root), "OMP_NUM_THREADS": "1"}
        command = [sys.executable, "-m", "skatemount", *words]
        return subprocess.run(command, capture_output=True, text=True, cwd=lab, env=environment, timeout=300)

    return call


def test_the_readmes_commands_name_what_there_is(
    lab: Path, run: Callable[..., subprocess.CompletedProcess[str]]
) -> None:
    for kind, name in (("stages", "lab_balance"), ("boards", "lab_wide"), ("suites", "lab-pushed")):
        assert re.search(rf"^{name} ", run("list", kind, "--config-dir", "conf").stdout, re.MULTILINE)
    assert re.search(r"^near_center ", run("list", "rewards", "plugins=[own_lab.terms]").stdout, re.MULTILINE)


@pytest.mark.slow
def test_the_lab_trains_evaluates_and_resumes(
    lab: Path, run: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    commands = [line.split() for line in README_COMMAND.findall((lab / "README.md").read_text(encoding="utf-8"))]
    assert [words[0] for words in commands] == ["list", "train", "evaluate", "record", "train"]
    for words in commands:
        if words[0] == "record":
            continue  # it needs OpenGL; it loads the policy as evaluate does
        resumes = "resume=latest" in words
        words = [word for word in words if not word.startswith("total_frames")]
        done = run(*words, *EXTRA["resume" if resumes else words[0]])
        assert done.returncode == 0, done.stderr
    result = json.loads((lab / "result.json").read_text(encoding="utf-8"))
    assert result["evaluated"]["suite"] == "lab-pushed"
    (folder,) = (lab / "runs").glob("*/*_lab_balance")
    saved = yaml.safe_load((folder / "config.yaml").read_text(encoding="utf-8"))
    assert saved["plugins"] == ["own_lab.terms"] and saved["board"]["deck_width"] == 0.3
    assert "trunk_height" in saved["observation"]["policy"] and str(lab) not in yaml.safe_dump(saved)
    metrics = [json.loads(line) for line in (folder / "metrics.jsonl").read_text(encoding="utf-8").splitlines()]
    assert len(metrics) == 3 and saved["reward"]["near_center"]["weight"] == 0.5

    # The same run elsewhere is a stranger's: it imports the plugin only when told to.
    shutil.copytree(folder, tmp_path / "download")
    words = ["evaluate", f"checkpoint={tmp_path / 'download'}", *EXTRA["evaluate"]]
    refused = run(*words)
    assert refused.returncode == 2 and refused.stderr.count("\n") == 1
    assert "repeat plugins=[own_lab.terms] if you trust them" in refused.stderr
    assert run(*words, "plugins=[own_lab.terms]").returncode == 0
