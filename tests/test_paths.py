"""Paths and names with any characters, as a user types them in a shell."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
import typing
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tiny import BATCH, TINY

from skatemount import cli
from skatemount.config import compose_program, overrides, set_user_config_dir
from skatemount.config.keys import keys
from skatemount.config.overrides import hydra_text, prepare, read
from skatemount.config.programs import PROGRAMS
from skatemount.evaluate import evaluate
from skatemount.runs.find import find_checkpoint
from skatemount.runs.folder import RunFolder
from skatemount.train import train
from skatemount.utils.errors import ConfigError

pytestmark = pytest.mark.usefixtures("no_pictures")

NAMES = [
    "ü",
    "a b",
    "a,b",
    "lr=3e-4,seed=1",
    "(a",
    "[a]",
    "{a: b}",
    "it's",
    'say "x"',
    "a$b",
    "1e3",
    "true",
    "#a",
    "a\\b",
]
"""Names that Hydra would read in another way, or not at all."""

TEXTS = {
    **dict.fromkeys(["resume", "init_from", "algorithm.teacher", "stage.init_from", "stage.description"], "train"),
    **dict.fromkeys(["logger.root", "logger.name", "logger.experiment"], "train"),
    **dict.fromkeys(["checkpoint", "pipeline", "json", "output", "suite.description"], "evaluate"),
    **dict.fromkeys(["run", "against", "sweep"], "report"),
    "host": "play",
}
"""Settings whose values are paths, names and sentences, each with a program that has it."""

CHOICES = {
    "agent", "algorithm.kind", "command.board_point", "command.mode", "command.turn_to", "curriculum.kind",
    "curriculum.name", "film.background", "film.camera", "format", "network.activation", "network.kind", "physics.cone",
    "physics.device", "physics.engine", "physics.solver", "precision", "robot.variant", "search.pruner",
    "search.sampler", "stage.name", "success", "suite.ladder", "suite.name", "suite.stage", "suite.unit", "viewer",
}  # fmt: skip
"""Settings that take one of a few words, or a name of letters and digits."""

ALL = "ä b,c=(d)'e$f\"g"


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], runs_root: Path) -> Callable[..., Any]:
    """Calls a program with arguments; returns its standard output."""
    monkeypatch.setenv("HYDRA_FULL_ERROR", "0")

    def call(verb: Callable[..., Any], program: str, *arguments: str) -> str:
        monkeypatch.setattr(sys, "argv", [program, *arguments])
        try:
            cli.run(verb, program)
        except SystemExit as error:
            pytest.fail(f"status {error.code}: {capfd.readouterr().err}")
        return capfd.readouterr().out

    yield call
    set_user_config_dir(None)


@pytest.mark.parametrize("name", NAMES)
def test_paths_are_what_was_typed(name: str) -> None:
    for setting, program in TEXTS.items():
        for value in (name, f"x/{name}/best"):
            (prepared,) = prepare([f"{setting}={value}"], program)
            assert read(prepared).value() == value
            assert prepare([prepared], program) == [prepared]  # once is enough
    for setting in ("runs", "page.results"):
        if "," in name or "'" in name:
            continue  # commas separate paths, and quotes are as those of a shell
        (prepared,) = prepare([f"{setting}=[{name},x/{name}/best.json]"], "report")
        assert read(prepared).value() == [name, f"x/{name}/best.json"]
        assert prepare([prepared], "report") == [prepared]


def test_lists_of_paths_may_have_quotes_and_be_swept() -> None:
    (prepared,) = prepare(["runs=['a,b', c (1)]"], "report")
    assert read(prepared).value() == ["a,b", "c (1)"]
    given = ["runs=[a,b],[c,d]", "page.results=[]", "runs=[${oc.env:HOME}]"]
    assert prepare(given, "report", multirun=True) == given


def test_every_setting_is_a_choice_or_taken_as_it_is_typed() -> None:
    """A path, name or sentence may have any characters; one of a few words, or of letters and digits, needs no care."""
    assert TEXTS.keys() == overrides._TEXTS
    found = {
        setting
        for schema in PROGRAMS.values()
        for setting, hint in keys(schema).items()
        if str in (hint, *typing.get_args(hint)) and typing.get_origin(hint) is not dict
    }
    lists = {"callbacks", "logger.loggers", "plugins", "suite.members", "suite.overrides", "runs", "page.results"}
    assert found - lists == overrides._TEXTS | CHOICES


def test_values_that_are_hydras_stay() -> None:
    given = ["init_from=null", "json='a b.json'", "output=${oc.env:HOME}", "checkpoint=pretrained:balance"]
    assert prepare(given[:1], "train") + prepare(given[1:], "evaluate") == given


def test_a_comma_in_a_multirun_separates_unless_the_path_exists(runs_root: Path) -> None:
    def values(written: str) -> list[str]:
        override = read(prepare([written], "evaluate", multirun=True)[0])
        return list(override.sweep_string_iterator()) if override.is_sweep_override() else [override.value()]

    assert values("checkpoint=a,b c") == ["a", "'b c'"]
    assert values("checkpoint='a,b',c") == ["'a,b'", "c"]
    assert values("checkpoint=it's,b") == [hydra_text("it's"), "b"]
    assert values("checkpoint=choice(a,b)") == ["a", "b"]
    (runs_root / "a,b").mkdir()
    assert values("checkpoint=a,b") == ["a,b"] and values("checkpoint=runs/a,b") == ["runs/a,b"]
    (runs_root / "a,b" / "best").touch()
    assert values("checkpoint=a,b/best") == ["a,b/best"]


@pytest.mark.parametrize("name", ["a/b", "..", ".hidden", "", " a", "a ", "a\nb", "x" * 201, "ü" * 101])
def test_a_runs_name_is_one_folder(name: str, runs_root: Path) -> None:
    with pytest.raises(ConfigError, match="must be the name of one folder"):
        RunFolder.create(runs_root, "exp", name, {}, [])
    with pytest.raises(ConfigError, match="must be the name of one folder"):
        RunFolder.create(runs_root, name, "run", {}, [])


def test_a_run_of_any_name_trains_resumes_and_is_evaluated(command: Callable[..., Any], runs_root: Path) -> None:
    root = runs_root.parent / f"runs {ALL}"
    place = [f"logger.root={root}", f"logger.experiment={ALL}"]
    tiny = ["stage=balance", *TINY]
    out = command(train, "train", *tiny, *place, f"logger.name={ALL}", f"total_frames={BATCH}")
    (run,) = (root / ALL).iterdir()
    assert run.name.endswith(f"_{ALL}") and f"run: {run}\n" in out
    assert find_checkpoint("latest", root).parents[1] == run

    seen: list[Any] = []
    commands = [line for line in out.splitlines() if line.startswith("  python -m skatemount.")]
    assert len(commands) == 2
    for line in commands:
        _, _, module, *arguments = shlex.split(line)
        program = module.removeprefix("skatemount.")
        command(lambda config, overrides: seen.append(config), program, *arguments)
        assert find_checkpoint(seen[-1].checkpoint).parents[1] == run

    relative = f"{ALL}/{run.name}"
    command(train, "train", f"resume={relative}", f"logger.root={root}", f"total_frames={2 * BATCH}")
    assert find_checkpoint(str(run)).name == f"step_{2 * BATCH:012d}"
    out = command(train, "train", *tiny, *place, f"init_from={run}", f"total_frames={BATCH}")
    assert f"starts from {run} (" in out

    folder = runs_root.parent / f"results {ALL}"
    out = command(
        evaluate, "evaluate", f"checkpoint={run}/latest", "episodes=2", "physics.num_worlds=2", "episode_length=0.8",
        "physics.threads=1", f"json={folder}/r {ALL}.json", f"output={folder}",
    )  # fmt: skip
    assert json.loads((folder / f"r {ALL}.json").read_text())["episodes"] == 2
    assert len(list(folder.iterdir())) == 3
    film = next(line for line in out.splitlines() if line.startswith("film ")).partition(": ")[2]
    command(lambda config, overrides: seen.append(config), "record", *shlex.split(film)[3:])
    assert find_checkpoint(seen[-1].checkpoint).parents[1] == run


def test_a_folder_of_settings_may_have_any_name(command: Callable[..., Any], runs_root: Path) -> None:
    folder = runs_root.parent / f"conf {ALL}"
    (folder / "board").mkdir(parents=True)
    (folder / "board" / "mine.yaml").write_text("# @package board\ndefaults: [default]\ndeck_length: 0.9\n")
    seen: list[Any] = []

    def verb(config: Any, overrides: list[str]) -> None:
        seen.append((config.board.deck_length, compose_program("train", overrides).board.deck_length))

    for option in (["--config-dir", str(folder)], [f"--config-dir={folder.name}"]):
        command(verb, "train", *option, "stage=balance", "board=mine")
    assert seen == [(0.9, 0.9)] * 2


def test_text_that_the_locale_does_not_have_is_one_line(runs_root: Path) -> None:
    environment = {**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    done = subprocess.run(
        [sys.executable, "-m", "skatemount.train", "stage=balance", "logger.name=ü"],
        capture_output=True, env=environment, cwd=runs_root.parent,
    )  # fmt: skip
    assert done.returncode == 2 and done.stdout == b""
    assert done.stderr.count(b"\n") == 1 and b"not text in this locale; set LC_ALL" in done.stderr
