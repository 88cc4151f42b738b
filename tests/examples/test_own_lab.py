"""The example of a lab with everything of its own, used as its README says, with an installed package.

The wheel is installed into a folder of its own, and the clone cannot be imported.
"""

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

Run = Callable[..., "subprocess.CompletedProcess[str]"]

ROOT = Path(__file__).resolve().parents[2]
PLUGINS = [f"own_lab.{name}" for name in ("terms", "memory", "tasks", "robots")]
EVALUATE = ["episodes=4", "physics.num_worlds=4", "physics.threads=1", "episode_length=1.0"]
EXTRA = {
    "list": [],
    "train": [*(word for word in TINY if "episode_length" not in word), "episode_length=0.16", "total_frames=64"],
    "evaluate": [*EVALUATE, "json=result.json"],
    "record": ["physics.num_worlds=4", "physics.threads=1", "episode=0", "film.width=160", "film.height=120"],
    "resume": ["total_frames=96"],
}
"""Tiny settings for each command of the README. An episode of the training lasts four steps."""
LIST = """
from skatemount.listing import listed

for kind in ("stages", "tasks", "robots", "boards", "suites", "rewards"):
    print(listed([kind, "--config-dir", "conf", "plugins=[{plugins}]"]))
"""
WITHOUT_CLONE = """
import pathlib
import sys

here = pathlib.Path(__file__).parent
others = [path for path in sys.path if pathlib.Path(path) != here]
removed = [path for path in others if (pathlib.Path(path) / "skatemount").exists()]
sys.path[:] = [path for path in sys.path if path not in removed]
"""
"""A `sitecustomize`, which Python imports after it has read the paths of editable installs: it removes those paths."""
WHERE = """
import sys
import skatemount
from skatemount.config.files import find_file

print(skatemount.__file__, find_file("task", "mount"), *sys.path, sep="\\n")
"""


def commands(folder: Path) -> dict[str, list[str]]:
    """Return the words of the README's commands, with tiny settings, by their names."""
    text = (folder / "README.md").read_text(encoding="utf-8")
    found = {}
    for line in re.findall(r"^    skatemount (.+)$", text, re.MULTILINE):
        words = [word for word in line.split() if not word.startswith("total_frames")]
        name = "resume" if "resume=latest" in words else words[0]
        found[name] = [*words, *EXTRA[name]]
    return found


def program(cwd: Path, *paths: Path) -> Run:
    """Return a function that runs Python with these paths in a folder."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, paths)), "OMP_NUM_THREADS": "1"}

    def run(*words: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, *words]
        return subprocess.run(command, capture_output=True, text=True, cwd=cwd, env=environment, timeout=300)

    return run


def test_the_readme_names_what_there_is(tmp_path: Path) -> None:
    lab = Path(shutil.copytree(ROOT / "examples" / "own_lab", tmp_path / "lab"))
    run = program(lab, ROOT)
    assert list(commands(lab)) == ["list", "train", "evaluate", "record", "resume"]
    text = (lab / "README.md").read_text(encoding="utf-8")
    files = [path.relative_to(lab).as_posix() for path in lab.rglob("*.*") if path.suffix in (".py", ".yaml")]
    assert sorted(re.findall(r"`([\w/-]+\.(?:py|yaml))`", text)) == sorted(set(files) - {"own_lab/__init__.py"})
    listed = run("-c", LIST.format(plugins=",".join(PLUGINS)))
    names = re.findall(r"^(lab[_-]\w+|near_center|time_in_the_air) ", listed.stdout, re.MULTILINE)
    expected = ["lab_carry", "lab_carry", "lab_loaded_a1", "lab_wide", "lab-pushed", "near_center", "time_in_the_air"]
    assert names == expected, listed.stderr


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Run]:
    """A trained copy of the example, and a function that runs the installed `skatemount` in it."""
    folder = tmp_path_factory.mktemp("installed")
    installed = folder / "site"
    for command in (
        ["hatchling", "build", "-t", "wheel", "-d", str(folder / "wheel")],
        ["pip", "install", "-q", "--no-deps", "--no-index", "--find-links", str(folder / "wheel")]
        + ["--target", str(installed), "skatemount"],
    ):
        done = subprocess.run([sys.executable, "-m", *command], capture_output=True, text=True, cwd=ROOT)
        assert done.returncode == 0, done.stderr
    (installed / "sitecustomize.py").write_text(WITHOUT_CLONE, encoding="utf-8")
    copy = Path(shutil.copytree(ROOT / "examples" / "own_lab", folder / "lab"))
    python = program(copy, installed)
    code, settings, *paths = python("-c", WHERE).stdout.split("\n")
    assert Path(code).is_relative_to(installed) and Path(settings).is_relative_to(installed)
    assert [path for path in paths if path and (Path(path) / "skatemount").exists()] == [str(installed)]

    def run(*words: str) -> subprocess.CompletedProcess[str]:
        return python(str(installed / "bin" / "skatemount"), *words)

    for name in ("list", "train"):
        done = run(*commands(copy)[name])
        assert done.returncode == 0, done.stderr
    return copy, run


@pytest.mark.slow
def test_a_run_stores_the_labs_values_and_no_paths(lab: tuple[Path, Run]) -> None:
    folder, _ = lab
    (run_folder,) = (folder / "runs").glob("*/*_lab_carry")
    saved = yaml.safe_load((run_folder / "config.yaml").read_text(encoding="utf-8"))
    assert saved["plugins"] == PLUGINS and str(folder) not in yaml.safe_dump(saved)
    assert (saved["success"], saved["robot"]["variant"]) == ("lab_carry", "lab_loaded_a1")
    assert saved["board"]["deck_width"] == 0.3 and saved["reward"]["near_center"]["weight"] == 0.5
    assert "trunk_height" in saved["observation"]["policy"] and "fallen" in saved["termination"]
    metrics = [json.loads(line) for line in (run_folder / "metrics.jsonl").read_text(encoding="utf-8").splitlines()]
    assert {"Success/feet", "Episode_Reward/time_in_the_air"} <= set(metrics[-1])


@pytest.mark.slow
def test_it_is_evaluated_and_resumed(lab: tuple[Path, Run]) -> None:
    folder, run = lab
    for name in ("evaluate", "resume"):
        done = run(*commands(folder)[name])
        assert done.returncode == 0, done.stderr
    result = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    assert result["evaluated"]["suite"] == "lab-pushed" and result["episodes"] == 4
    assert result["largest_tilt"]["median"] > 0 and 0 <= result["feet"] <= 4
    (run_folder,) = (folder / "runs").glob("*/*_lab_carry")
    lines = (run_folder / "metrics.jsonl").read_text(encoding="utf-8").splitlines()
    assert [json.loads(line)["frames"] for line in lines] == [32, 64, 96]


@pytest.mark.slow
@pytest.mark.skipif(os.environ.get("MUJOCO_GL") not in ("egl", "osmesa"), reason="needs OpenGL without a display")
def test_it_is_filmed(lab: tuple[Path, Run]) -> None:
    folder, run = lab
    done = run(*commands(folder)["record"])
    assert done.returncode == 0, done.stderr
    (film,) = folder.glob("runs/*/*_lab_carry/videos/*.mp4")
    assert film.stat().st_size > 1000


@pytest.mark.slow
def test_a_copy_of_the_run_elsewhere_imports_the_plugins_only_when_told_to(lab: tuple[Path, Run]) -> None:
    folder, run = lab
    (run_folder,) = (folder / "runs").glob("*/*_lab_carry")
    download = shutil.copytree(run_folder, folder.parent / "download")
    refused = run("evaluate", f"checkpoint={download}", *EVALUATE)
    assert refused.returncode == 2 and refused.stderr.count("\n") == 1
    assert f"repeat plugins=[{','.join(PLUGINS)}] if you trust them" in refused.stderr
    assert run("evaluate", f"checkpoint={download}", *EVALUATE, f"plugins=[{','.join(PLUGINS)}]").returncode == 0
