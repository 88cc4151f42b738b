"""The example of a robot outside of the package: it is built, stands, and is trained as its README says."""

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
    "evaluate": ["episodes=4", "physics.num_worlds=4", "physics.threads=1", "episode_length=1.0", "json=result.json"],
    "list": [],
}
"""Tiny settings for each command of the README."""

STANDS = """
import torch
from skatemount.config import set_user_config_dir
from skatemount.envs import MountEnv, MountTask

set_user_config_dir("conf")
still = [f"start.{n}=[0,0]" for n in ("height", "roll", "pitch", "lin_vel", "ang_vel", "joint_pos", "joint_vel")]
task = MountTask("go1_balance", ["randomization=none", *still])
robot = task.scene.robot
env = MountEnv(task, num_worlds=8, threads=1)
data = env.reset()
for _ in range(25):
    data = env.step(data.set("action", torch.zeros(8, 12)))["next"]
    assert not data["terminated"].any()
assert (env.sim.body_force == 0).all(), "only the feet may touch"
print(robot.spec.name, len(robot.joints), (env.sim.foot_deck_force != 0).any(-1).sum().item())
"""
"""A second of zero actions; prints the robot's name, its joints, and how many of the 32 feet press on the deck."""


@pytest.fixture
def folder(repo_root: Path, tmp_path: Path) -> Path:
    """A copy of the example, outside of the clone."""
    return Path(shutil.copytree(repo_root / "examples" / "own_robot", tmp_path / "own"))


@pytest.fixture
def run(repo_root: Path, folder: Path) -> Callable[..., subprocess.CompletedProcess[str]]:
    def call(*words: str) -> subprocess.CompletedProcess[str]:
        environment = os.environ | {"PYTHONPATH": str(repo_root), "OMP_NUM_THREADS": "1"}
        return subprocess.run(
            [sys.executable, *words], capture_output=True, text=True, cwd=folder, env=environment, timeout=300
        )

    return call


def test_the_page_shows_the_examples_stage(repo_root: Path, folder: Path) -> None:
    (shown,) = re.findall(
        r"```yaml\n(.*?)```", (repo_root / "docs" / "robots.md").read_text(encoding="utf-8"), re.DOTALL
    )
    assert shown == (folder / "conf" / "stage" / "go1_balance.yaml").read_text(encoding="utf-8")


def test_it_stands_for_a_second(run: Callable[..., subprocess.CompletedProcess[str]]) -> None:
    done = run("-c", STANDS)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["go1", "12", "32"]


def test_a_robot_whose_plugin_is_missing_is_one_line(run: Callable[..., subprocess.CompletedProcess[str]]) -> None:
    done = run("-m", "skatemount", "train", "--config-dir", "conf", "stage=balance", "robot=go1")
    assert done.returncode == 2
    said = "robot.variant=go1 must be one of a1, a1_isaac, go2; one of your own needs plugins=[<module>]"
    assert done.stderr.endswith(f"go1.yaml, line 6: {said}\n") and done.stderr.count("\n") == 1


def test_the_readmes_commands_train_and_evaluate_it(
    folder: Path, run: Callable[..., subprocess.CompletedProcess[str]]
) -> None:
    commands = [line.split() for line in README_COMMAND.findall((folder / "README.md").read_text(encoding="utf-8"))]
    assert [words[0] for words in commands] == ["list", "train", "evaluate", "record"]
    for words in commands[:3]:  # the last one needs OpenGL; it loads the policy as evaluate does
        done = run("-m", "skatemount", *words, *EXTRA[words[0]])
        assert done.returncode == 0, done.stderr
        if words[0] == "list":
            assert re.search(r"^go1 +The Unitree Go1 as published", done.stdout, re.MULTILINE)
    (run_folder,) = (folder / "runs").glob("*/*_go1_balance")
    saved = yaml.safe_load((run_folder / "config.yaml").read_text(encoding="utf-8"))
    assert saved["plugins"] == ["own_robot.go1"] and saved["robot"]["variant"] == "go1"
    assert len((run_folder / "metrics.jsonl").read_text(encoding="utf-8").splitlines()) == 2
    assert json.loads((folder / "result.json").read_text(encoding="utf-8"))["episodes"] == 4
