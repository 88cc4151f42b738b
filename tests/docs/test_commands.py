"""The commands of quick start, tutorials and gallery run in the order of the page, with tiny settings.

The output that a page shows must have the lines that the command prints today; numbers and paths may differ.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from scripts import load_script

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "docs" / "quickstart.md", ROOT / "docs" / "gallery.md", *sorted((ROOT / "docs/tutorials").glob("*.md"))]
EXTRAS = set(tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"])
WORLDS = ["physics.num_worlds=4", "physics.threads=1"]
TINY = {
    "train": [
        *("physics.num_worlds=8", "collector.steps_per_env=4", "physics.threads=1", "torch_threads=1"),
        *(
            "logger.evaluate_every=0",
            "logger.final_episodes=4",
            "algorithm.compile=false",
            "total_frames=64",
            "episode_length=1.0",
        ),
    ],
    "evaluate": [*WORLDS, "episodes=4", "episode_length=1.0"],
    "record": [*WORLDS, "film.width=160", "film.height=120", "episode=0"],
    "report": [*WORLDS, "page.episodes=4", "page.films=0", "episode_length=1.0"],
    "export": ["episodes=2", "suite=balance-fixed", "physics.threads=1"],
    "runner": ["episodes=2"],
    "play": ["worlds=1", "open_browser=false", "port=18300", "physics.threads=1"],
    "list": [],
}
"""Settings that replace or follow those of a command."""
KEPT = ("suite=", "episodes=0")
"""Settings of a command that stay."""
ONLY_SOMETIMES = ("failed episode", "film a failure", "film the first", "failures ", "filming", "Killed")
"""Beginnings of lines that depend on how the episodes end."""


REFUSED = {"skatemount train --config-dir conf stage=balance board=lab_wide board.wheelbase=0.7"}
"""Commands whose page shows the error."""


@pytest.fixture(scope="module")
def run_page() -> ModuleType:
    return load_script("tools/run_page.py")


@pytest.fixture(scope="module")
def command() -> Iterator[Callable[..., dict[str, Any]]]:
    """A function that runs words in a folder, through `page_driver`."""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "COLUMNS": "200"}
    driver = subprocess.Popen(
        [sys.executable, str(ROOT / "tests" / "page_driver.py")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=environment,
    )
    assert driver.stdin is not None and driver.stdout is not None

    def run(words: list[str], cwd: Path, interrupt_at: str = "") -> dict[str, Any]:
        print(
            json.dumps({"words": words, "cwd": str(cwd), "interrupt_at": interrupt_at}), file=driver.stdin, flush=True
        )
        answer: dict[str, Any] = json.loads(driver.stdout.readline())
        return answer

    yield run
    driver.stdin.close()
    assert driver.wait(120) == 0


def program_of(words: list[str]) -> str:
    """Return the program of a command; "" for one of the shell."""
    if words[0] == "skatemount":
        return words[1]
    return words[2].removeprefix("skatemount.") if words[:2] == ["python", "-m"] else ""


def tiny(words: list[str], program: str) -> list[str]:
    """Return a command with tiny settings; a sweep keeps two values of each list."""
    if "--cfg" in words:
        return words  # it only prints settings
    more = TINY[program]
    if program == "report" and not any(word.startswith("run=") for word in words) or "paper=true" in words:
        more = ["page.films=0"]
    if program == "record" and any(word.startswith("episodes=") for word in words):
        more = ["episodes=2" if word == "episode=0" else word for word in more]
    if program == "export" and "episodes=0" in words:
        more = ["physics.threads=1"]  # no start states, so no suites
    if "resume=latest" in words:
        more = ["total_frames=96"]
    if "curriculum=paper" in words:
        # Gates need evaluations, and each of the five stages an iteration.
        more = [word for word in more if not word.startswith(("total_frames", "logger.evaluate_every"))]
        more += ["total_frames=160", "logger.evaluate_every=99", "logger.evaluate_episodes=4"]
    kept = [word for word in words if word.startswith(KEPT)]
    replaced = {word.split("=")[0] for word in more} - {word.split("=")[0] for word in kept}
    short = [re.sub(r"(=[^,\[]+,[^,]+),.*", r"\1", word) for word in words]
    short = [word for word in short if not word.startswith(("hydra", "launcher="))]
    return [word for word in short if word.split("=")[0] not in replaced] + [
        word for word in more if word.split("=")[0] in replaced
    ]


def heads(text: str) -> set[tuple[str, ...]]:
    """Return the first words of each line."""
    return {tuple(re.findall(r"[A-Za-z]{2,}", line)[:2]) for line in text.splitlines()}


def missing(shown: list[str], printed: str) -> list[str]:
    """Return the lines of a page that begin with other words than all lines that were printed."""
    known = heads(printed)
    return [
        line
        for line in shown
        if re.match(r"\s*[A-Za-z]", line)
        and not line.lstrip().startswith(ONLY_SOMETIMES)
        and not re.search(r"\(\d+%\)", line)  # a line of progress, which a tiny training has not
        and not heads(line) <= known
    ]


def check_shell(words: list[str]) -> None:
    """Check a command that prepares the environment, which runs in another test or in CI itself."""
    if words[0] == "make":
        assert re.search(rf"^{words[1]}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    elif words[0] == "pip":
        (extras,) = [word for word in words if word.startswith(".[")]
        assert set(extras[2:-1].split(",")) <= EXTRAS and (ROOT / words[words.index("-c") + 1]).is_file()
    else:
        assert words == [".", ".venv/bin/activate"]


def settled(command: str, cwd: Path) -> list[str]:
    """Return the words of a command; of a name such as `2026-…_sweep` the newest folder that fits."""
    words = shlex.split(command.replace("\\\n", " "))
    for i, word in enumerate(words):
        if "…" in word:
            key, _, path = word.rpartition("=")
            root = cwd if path.startswith("runs/") else cwd / "runs"
            found = sorted(root.glob(path.replace("2026-…", "*")))
            assert found, word
            words[i] = f"{key}={found[-1].relative_to(root)}"
    return words


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_commands_of_a_page_run(
    page: Path, tmp_path: Path, run_page: ModuleType, command: Callable[..., dict[str, Any]]
) -> None:
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    (tmp_path / "benchmarks").symlink_to(ROOT / "benchmarks")
    cwd = tmp_path
    blocks = run_page.blocks(page.read_text(encoding="utf-8"))
    assert blocks
    draws = os.environ.get("MUJOCO_GL") in ("egl", "osmesa")
    for block in blocks:
        printed = ""
        for text in block.commands:
            words = settled(text, cwd)
            program = program_of(words)
            if words[0] == "cd":
                cwd = cwd / words[1]
            elif words[0] in (".", "make", "pip"):
                check_shell(words)
            elif words[0] == "python" and words[1].startswith("benchmarks/"):
                done = command([*words[:2], "--help"], cwd)
                assert {word for word in words if word.startswith("--")} <= set(re.findall(r"--\w+", done["printed"]))
            else:
                given = tiny(words, program) if program else words
                done = command(given, cwd, "open http" if program == "play" else "")
                refused = text in REFUSED or program == "record" and not draws
                expected = 2 if refused else 130 if program == "play" else 0
                assert done["status"] == expected, f"{shlex.join(given)}\n{done['printed']}"
                printed = done["printed"]
        if len(block.commands) == 1 and program:
            assert missing(block.output, printed) == [], printed


def test_blocks_are_read_and_filled(run_page: ModuleType) -> None:
    page = "```console\n$ one \\\n    more\na\n...\nz\n[1 s, processor 2 s]\n```\n\n```console\n$ two\n$ three\n```\n"
    first, second = run_page.blocks(page)
    assert (first.commands, first.output, first.timed) == (["one \\\n    more"], ["a", "...", "z"], True)
    assert second.commands == ["two", "three"]
    assert first.filled("1\n2\n3\n4\n", 12.4, 3.6) == "$ one \\\n    more\n1\n...\n4\n[12 s, processor 4 s]\n"
    assert first.filled("1\n2\n", 0, 0) == "$ one \\\n    more\n1\n2\n[0 s, processor 0 s]\n"


class _StandingStill:
    """A page of `play` whose time does not pass."""

    def __getattr__(self, name: str) -> Callable[..., Any]:
        return lambda *given, **named: self

    def inner_text(self, selector: str) -> str:
        return "0.04 s"

    first = property(lambda self: self)


def test_waiting_for_a_page_ends_with_what_it_shows(run_page: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_page.chromium, "launched", lambda: contextlib.nullcontext(_StandingStill()))
    monkeypatch.setattr(run_page, "PATIENCE", 0.0)
    with pytest.raises(RuntimeError) as error:
        run_page.push("http://127.0.0.1:1", None)
    assert str(error.value) == "waited 0 s for an episode's time of 2 to 4.5 s; the page shows '0.04 s'"
    monkeypatch.setattr(run_page, "MOUNTED", (0.0, 1.0))
    with pytest.raises(RuntimeError, match=r"^waited 0 s for a step after 0.04 s; the page shows '0.04 s'$"):
        run_page.push("http://127.0.0.1:1", None)


def test_a_program_that_prints_no_address_is_ended(
    run_page: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(run_page, "PATIENCE", 0.0)
    shell = run_page.Shell(tmp_path)
    with pytest.raises(RuntimeError, match="^waited 0 s for an address that play prints; it printed: $"):
        shell.play("sh -c 'exec sleep 600'", None)
    assert shell.run("kill -0 $playing")[0] != 0
    with pytest.raises(RuntimeError, match="^play ended: nothing here"):
        monkeypatch.setattr(run_page, "PATIENCE", 60.0)
        shell.play("sh -c 'echo nothing here'", None)


def test_lines_that_a_command_no_longer_prints_are_found() -> None:
    printed = "balance: 8 worlds\n episodes    4\n success   50.0%\nrun: a/b\n"
    assert missing(["balance: 1024 worlds", " ────", " episodes   256", "220  x", "..."], printed) == []
    assert missing([" feet on board  3.9"], printed) == [" feet on board  3.9"]


def test_tiny_settings_replace_those_of_the_page() -> None:
    words = shlex.split("python -m skatemount.train -m stage=balance seed=0,1,2 total_frames=4e6 hydra/launcher=joblib")
    short = tiny(words, "train")
    assert {"seed=0,1", "total_frames=64", "-m", "stage=balance"} <= set(short)
    assert "total_frames=4e6" not in short and "hydra/launcher=joblib" not in short
    assert tiny(["skatemount", "export", "suite=far", "episodes=0"], "export")[2:] == [
        "suite=far",
        "episodes=0",
        "physics.threads=1",
    ]
