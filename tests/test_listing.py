"""`skatemount list`, and the command that has every program."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from skatemount import __main__ as command
from skatemount import listing
from skatemount.config import set_user_config_dir, stages
from skatemount.config.files import choices
from skatemount.config.registries import registries
from skatemount.envs.rewards import REWARDS
from skatemount.envs.robots import ROBOTS
from skatemount.listing import KINDS, listed
from skatemount.runs.shipped import shipped_policies
from skatemount.utils.errors import ConfigError

PLUGIN = """
from dataclasses import replace
from skatemount.envs.rewards import reward
from skatemount.envs.robots import A1, ROBOTS
from skatemount.envs.tasks import TASKS

@reward
def hop(sim, episode, context):
    'Reward hops.'

ROBOTS["twin"] = A1
TASKS.register(replace(TASKS.get("mount"), name="hops", description="hop about"))
"""


@pytest.fixture(autouse=True)
def no_folder_afterwards() -> Iterator[None]:
    yield
    set_user_config_dir(None)


def rows(*arguments: str) -> dict[str, str]:
    """Return the names in a table with their descriptions."""
    pairs = (line.split(maxsplit=1) for line in listed(arguments).splitlines())
    return {name: "".join(about) for name, *about in pairs}


@pytest.mark.parametrize("kind", KINDS)
def test_every_row_has_a_description_of_one_line(kind: str) -> None:
    found = rows(kind)
    assert found and all(found.values())


def test_a_table_has_every_name() -> None:
    assert rows("stages") == stages()
    assert list(rows("boards")) == choices("board") and list(rows("policies")) == shipped_policies()
    assert rows("policies")["pretrained:anywhere"] == (
        "8.01M steps in stage unfixed, from pretrained:unfixed-two-frames; with the settings, given one by one, that "
        "stage anywhere has since"
    )
    assert rows("policies")["pretrained:unfixed"] == "45.02M steps in stage unfixed, from scratch"
    assert list(rows("rewards")) == REWARDS.names()
    assert "feet that press on the deck" in rows("rewards")["feet_on_board"]


def test_robots_have_their_mass() -> None:
    found = rows("robots")
    assert list(found) == ["a1", "a1_isaac", "go2"]
    assert [re.findall(r"\d+\.\d+ kg", about) for about in found.values()] == [
        [f"{ROBOTS[name].mass:.3f} kg"] for name in found
    ]


def test_terms_of_a_stage_are_those_that_it_uses() -> None:
    assert rows("rewards", "stage=balance")["mounted"] == "weight 2"
    gait = rows("stage=gait", "rewards")
    assert gait["track_lin_vel"] == "weight 3" and "mounted" not in gait
    assert "out_of_reach" not in rows("terminations", "stage=gait") and "tilt" in rows("terminations", "stage=gait")
    seen = rows("observations", "stage=hold")
    assert seen["outline"] == "for the policy, points=16" and seen["heights"] == "for the critic"


def test_broken_files_say_why(tmp_path: Path) -> None:
    files = {
        "stage/a.yaml": "stage: [",
        "stage/b.yaml": "# @package _global_\n# A stage.\nstage: {name: b, descripton: x}\n",
        "board/c.yaml": "# A board.\nmass: heavy\n",
        "suite/d.yaml": "name: d\nverson: 1\nstage: balance\n",
        "task/e.yaml": "# @package _global_\n# A task.\nsuccess: nothing\n",
        "robot/f.yaml": "# A robot.\ndefaults: [a1, _self_]\nvariant: lost\n",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    for name in files:
        group, stem = Path(name).parent.name, Path(name).stem
        about = rows(f"{group}s", "--config-dir", str(tmp_path))[stem]
        assert about.startswith(f"broken: {tmp_path / name}, line "), about
    assert rows("stages", "--config-dir", str(tmp_path))["balance"] == stages()["balance"]


def test_without_a_kind_the_kinds_are_listed() -> None:
    text = listed([])
    assert all(f"\n{kind} " in text for kind in KINDS)


def test_ones_own_files_and_terms_are_listed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    board = tmp_path / "conf" / "board" / "wide.yaml"
    board.parent.mkdir(parents=True)
    board.write_text("# A wide board. It is slow.\ndefaults: [default, _self_]\n", encoding="utf-8")
    assert rows("boards", "--config-dir", str(tmp_path / "conf"))["wide"] == "A wide board"
    assert rows(f"--config-dir={tmp_path / 'conf'}", "boards")["wide"] == "A wide board"
    assert "wide" not in rows("boards")
    (tmp_path / "listed_terms.py").write_text(PLUGIN, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    saved = [(each, each.snapshot()) for each in registries()]
    try:
        assert rows("rewards", "plugins=[listed_terms]")["hop"] == "Reward hops."
        assert rows("tasks", "plugins=[listed_terms]")["success=hops"] == "hop about"
        assert rows("robots", "plugins=[listed_terms]")["robot.variant=twin"] == "12.453 kg"
    finally:
        for registry, before in saved:
            registry.restore(before)
        del sys.modules["listed_terms"]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["stage"], "stage cannot be listed (did you mean stages?); there are: stages, tasks, suites,"),
        (["robots", "stage=balance"], "stage=balance: robots do not depend on settings, only rewards, observations,"),
        (["rewards", "stage=balence"], "stage=balence: there is no stage balence (did you mean balance?)"),
        (["rewards", "plugins=terms"], "plugins=terms must be a list such as [a, b]"),
        (["rewards", "plugins=[no_such]"], "plugins=[no_such]: there is no module no_such"),
        (["stages", "--config-dir", "nowhere"], "--config-dir nowhere: there is no such folder"),
    ],
)
def test_mistakes_are_one_line(
    arguments: list[str], expected: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(ConfigError):
        listed(arguments)
    monkeypatch.setattr(sys, "argv", ["list", *arguments])
    with pytest.raises(SystemExit) as ended:
        listing.main()
    err = capsys.readouterr().err
    assert ended.value.code == 2 and err.startswith(f"skatemount.list: {expected}") and err.count("\n") == 1


def test_the_command_says_what_programs_there_are(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["skatemount"])
    command.main()
    out = capsys.readouterr().out
    programs = ("train", "evaluate", "record", "play", "report", "export", "bench", "search", "runner", "list")
    assert all(f"\n  skatemount {name} " in out for name in programs)
    monkeypatch.setattr(sys, "argv", ["skatemount", "trian"])
    with pytest.raises(SystemExit) as ended:
        command.main()
    assert ended.value.code == 2
    assert capsys.readouterr().err == (
        "skatemount: there is no program trian; there are: train, evaluate, record, play, report, export, bench, "
        "search, runner, list, replay-diverged, robot-spec\n"
    )


@pytest.mark.parametrize("program", ["train", "evaluate", "list"])
def test_the_command_runs_a_program(
    program: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["skatemount", program, "--help"])
    command.main()
    assert {"train": "Train a policy", "evaluate": "how often", "list": "stages"}[program] in capsys.readouterr().out


def test_the_command_is_installed_and_knows_the_modules_of_the_working_directory(
    repo_root: Path, tmp_path: Path
) -> None:
    scripts = tomllib.loads((repo_root / "pyproject.toml").read_text(encoding="utf-8"))["project"]["scripts"]
    assert scripts == {"skatemount": "skatemount.__main__:main"}
    (tmp_path / "here_terms.py").write_text("", encoding="utf-8")
    # As the script that pip writes, which lies in another folder.
    code = f"import sys; sys.path[:1] = [{str(repo_root)!r}]; from skatemount.__main__ import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code, "list", "stages", "plugins=[here_terms]"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert done.returncode == 0 and "balance" in done.stdout, done.stderr
