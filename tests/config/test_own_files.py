"""An error in one of the user's own files is one line that names the file and the line."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from skatemount import cli
from skatemount.config import compose, set_user_config_dir, stages, to_dict
from skatemount.config.own_files import check_own_file, check_own_files, own_files, with_path, with_place
from skatemount.utils.errors import ConfigError

GLOBAL = "# @package _global_\nstage: {name: mine}\n"
"""The first two lines of a stage."""

REFUSED = [
    ("board/odd.yaml", "mass: [1\n", ", line 2: not plain YAML (while parsing a flow sequence expected "),
    ("board/odd.yaml", "mass: 1\ntrack: 1\nmass: 2\n", ", line 3: mass is there twice"),
    ("board/odd.yaml", "- a\n", ": holds a list, a mapping is needed"),
    ("board/odd.yaml", "", ": holds nothing, a mapping is needed"),
    ("stage/mine.yaml", f"{GLOBAL}board:\n  mss: 1\n", ", line 4: board.mss=1: there is no setting board.mss"),
    ("stage/mine.yaml", f"{GLOBAL}board: {{mass: heavy}}\n", ", line 3: board.mass=heavy must be a number"),
    ("stage/mine.yaml", f"{GLOBAL}episode_length: -1\n", ", line 3: episode_length=-1.0 must be above 0"),
    ("stage/mine.yaml", f"{GLOBAL}reward:\n  hop: {{weight: 1}}\n", ", line 4: reward.hop is not a known reward"),
    ("stage/mine.yaml", f"{GLOBAL}reward: [1]\n", ": ConfigTypeError raised while composing config"),
    ("stage/mine.yaml", "stage: {name: mine}\n", ", line 1: stage.stage: there is no setting"),
    ("stage/mine.yaml", f"{GLOBAL}defaults: balance\n", ", line 3: defaults must be a list"),
    ("search/mine.yaml", "trials: 3\n", " lacks `defaults: [default, _self_]`"),
    ("stage/mine.yaml", f"{GLOBAL}defaults:\n  - balence\n", ", line 4: there is no stage balence (did you mean bala"),
    ("stage/mine.yaml", f"{GLOBAL}defaults:\n  - mine\n", ": includes itself through its defaults list: mine > mine"),
    ("stage/mine.yaml", f"{GLOBAL}defaults: [override /bord: x]\n", ", line 3: override /bord: there is no group bord"),
    ("stage/mine.yaml", f"{GLOBAL}defaults: [override /board: x]\n", ", line 3: override /board: there is no board x"),
    ("stage/mine.yaml", f"{GLOBAL}defaults: [override board: x]\n", ", line 3: override board: write /board for"),
    ("stage/mine.yaml", f"{GLOBAL}defaults: [/board: [mini, carver]]\n", ", line 3: /board: takes one name; of a list"),
    ("stage/mine.yaml", f"{GLOBAL}defaults: [5]\n", ", line 3: 5: an entry of defaults is a name"),
    ("task/mine.yaml", "success: mount\n", ", line 1: task: there is no setting task"),
    ("task/mine.yaml", "defaults: [override /network: small]\n", ", line 1: override /network: a task can override"),
]  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    """An empty folder of one's own, used by the whole process."""
    root = tmp_path / "conf"
    (root / "board").mkdir(parents=True)
    set_user_config_dir(root)
    yield root
    set_user_config_dir(None)


def write(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.parent.mkdir(exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(("name", "text", "expected"), REFUSED)
def test_a_mistake_is_one_line_with_its_place(name: str, text: str, expected: str, folder: Path) -> None:
    path = write(folder, name, text)
    group = path.parent.name
    with pytest.raises(ConfigError) as error:
        check_own_files([f"{group}={path.stem}"])
        compose(None, [f"{group}={path.stem}"])
    assert str(error.value).startswith(f"{path}{expected}") and "\n" not in str(error.value)


def test_a_file_that_hydra_cannot_read_is_no_traceback(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("HYDRA_FULL_ERROR", "0")
    path = write(folder, "board/odd.yaml", "defaults:\n  - default\n  - _self_\nmass: {1: 2}\n")
    write(folder, "stage/mine.yaml", f"{GLOBAL}defaults:\n  - override /board: odd\n  - override /start@: 3\n")
    for text in (None, "mass: [1\n"):
        if text is not None:
            path.write_text(text, encoding="utf-8")
        monkeypatch.setattr(sys, "argv", ["train", "--config-dir", str(folder), "stage=mine"])
        with pytest.raises(SystemExit) as ended:
            cli.run(lambda config, overrides: None, "train")
        err = capsys.readouterr().err
        assert ended.value.code == 2 and err.startswith("skatemount.train: ") and err.count("\n") == 1
    monkeypatch.setattr(sys, "argv", ["train", "--config-dir", str(folder), "--help"])
    write(folder, "stage/other.yaml", "stage: [")
    cli.run(lambda config, overrides: None, "train")
    assert "other" in capsys.readouterr().out
    assert stages()["other"].startswith("broken: ") and "line 1" in stages()["other"]


def test_only_what_comes_from_a_file_gets_its_place(folder: Path) -> None:
    path = write(folder, "board/odd.yaml", "defaults: [default, _self_]\nmass: 3.0\n")
    write(folder, "board/unused.yaml", "mass: [")
    check_own_files(["board=odd", "seed=1"])
    check_own_file("board", path)
    assert [each for _, each in own_files()] == [path, path.with_name("unused.yaml")]
    values = to_dict(compose("balance", ["board=odd"]))
    wrong = ConfigError("board.mass=3.0 is too heavy")
    assert str(with_place(wrong, values)) == f"{path}, line 2: {wrong}"
    values["board"]["mass"] = 4.0  # as if the command line said so
    assert with_place(wrong, values) is wrong
    write(folder, "stage/mine.yaml", f"{GLOBAL}defaults: [override /board: unused]\n")
    with pytest.raises(ConfigError, match=r"unused\.yaml, line 1: not plain YAML"):
        check_own_files(["+stage=balance,mine"])
    said = "In 'board/odd': no. In 'board/default': no."
    assert with_path(said) == f"{path}: no. In 'board/default': no."
    set_user_config_dir(None)
    assert with_place(wrong, values) is wrong
