"""A user's own YAML files, outside of the package."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from skatemount import cli
from skatemount.config import (
    EvaluateConfig,
    compose,
    compose_program,
    config_dir_options,
    set_user_config_dir,
    stages,
    suites,
    to_dict,
    user_config_dir,
    using_config_dir,
)
from skatemount.config.files import choices
from skatemount.evaluation.suite_task import EvaluationTask, evaluation_config, load_suite
from skatemount.training.chain import Chain
from skatemount.utils.errors import ConfigError

FILES = {
    "stage/mine.yaml": "# @package _global_\ndefaults:\n  - override /board: wide\n  - override /start: on_deck\n"
    "stage:\n  name: mine\n  description: my own stage\n",
    "board/wide.yaml": "defaults:\n  - default\n  - _self_\ndeck_width: 0.31\n",
    "suite/mine-fixed.yaml": "name: mine-fixed\nversion: 3\ndescription: my own test\nstage: mine\n",
    "suite/both.yaml": "name: both\nversion: 1\ndescription: two\nmembers: [mine-fixed, balance-fixed]\n",
    "experiment/long.yaml": "# @package _global_\nepisode_length: 7.0\n",
    "curriculum/two.yaml": "kind: stages\nname: two\nstages:\n"
    "  balance: {gate: null, budget: 0.5, renormalize: false}\n  mine: {gate: null, budget: 0.5, renormalize: false}\n",
}


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    """A user's folder, with a space in its name."""
    root = tmp_path / "it's my conf"
    for name, text in FILES.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text, encoding="utf-8")
    yield root
    set_user_config_dir(None)


def test_a_stage_of_ones_own_composes(folder: Path) -> None:
    config = compose("mine", ["experiment=long"], config_dir=folder)
    assert (config.stage.name, config.board.deck_width, config.episode_length) == ("mine", 0.31, 7.0)
    assert str(folder) not in yaml.safe_dump(to_dict(config))


def test_the_folder_counts_for_the_call_or_the_block_alone(folder: Path) -> None:
    with using_config_dir(folder):
        assert stages()["mine"] == "my own stage" and suites()["mine-fixed"] == "my own test"
        assert user_config_dir() == folder and config_dir_options() == ["--config-dir", str(folder)]
    assert "mine" not in stages() and user_config_dir() is None and config_dir_options() == []
    with pytest.raises(ConfigError, match=r"stage=mine: there is no stage mine; there are: anywhere,"):
        compose("mine")


def test_errors_list_the_users_choices(folder: Path) -> None:
    with pytest.raises(
        ConfigError, match=r"^board=mide: there is no board mide \(did you mean wide\?\); there are: .*, wide$"
    ):
        compose("mine", ["board=mide"], config_dir=folder)


def test_suites_and_evaluations_know_the_folder(folder: Path) -> None:
    policy = compose("balance")
    set_user_config_dir(folder)
    config = compose_program("evaluate", ["suite=both"])
    assert isinstance(config, EvaluateConfig) and config.suite is not None
    assert config.suite.members == ["mine-fixed", "balance-fixed"]
    assert evaluation_config(policy, load_suite("mine-fixed")).board.deck_width == 0.31
    assert evaluation_config(policy, None, ["board=wide"]).board.deck_width == 0.31


def test_the_command_that_films_names_the_folder(folder: Path) -> None:
    from skatemount.agents.trained_policy import TrainedPolicy

    set_user_config_dir(folder)
    task = EvaluationTask.of(TrainedPolicy.load("pretrained:balance"), load_suite("mine-fixed"))
    assert task.record_command(0).startswith(f"python -m skatemount.record --config-dir {_quoted(folder)} checkpoint=")


def _quoted(path: Path) -> str:
    import shlex

    return shlex.quote(str(path))


def test_a_chain_may_have_stages_of_ones_own(folder: Path, runs_root: Path) -> None:
    set_user_config_dir(folder)
    overrides = ["curriculum=two", f"logger.root={runs_root}"]
    chain = Chain.begin(compose(None, overrides), overrides)
    assert [part.config.board.deck_width for part in chain.parts] == [compose("balance").board.deck_width, 0.31]


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda root: root / "nowhere", r"--config-dir .*nowhere: there is no such folder"),
        (lambda root: root / "stage", r"--config-dir .*stage: has no folder of a group; groups are algorithm, "),
        (lambda root: _with(root, "stage/mount.yaml"), r"the package has a stage mount; rename .*mount\.yaml"),
    ],
)
def test_a_wrong_folder_is_one_line(change, expected: str, folder: Path) -> None:
    with pytest.raises(ConfigError, match=expected) as error:
        compose("balance", config_dir=change(folder))
    assert "\n" not in str(error.value) and user_config_dir() is None


def _with(root: Path, name: str) -> Path:
    (root / name).write_text("{}\n", encoding="utf-8")
    return root


@pytest.mark.parametrize("option", [["--config-dir", "{}"], ["--config-dir={}"], ["-cd", "{}"]])
def test_the_command_line_takes_the_folder(
    option: list[str], folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder.parent)
    monkeypatch.setenv("HYDRA_FULL_ERROR", "0")
    seen = []
    words = [each.format(folder.name) for each in option]
    monkeypatch.setattr(sys, "argv", ["train", *words, "stage=mine", "experiment=long"])
    cli.run(lambda config, overrides: seen.append((config, overrides, choices("stage"))), "train")
    ((config, overrides, known),) = seen
    assert config.board.deck_width == 0.31 and overrides == ["stage=mine", "experiment=long"] and "mine" in known
    # Options may stand between settings.
    monkeypatch.setattr(sys, "argv", ["train", "stage=mine", *words, "experiment=long"])
    cli.run(lambda config, overrides: seen.append((config, overrides, choices("stage"))), "train")
    assert seen[1] == seen[0]
    monkeypatch.setattr(sys, "argv", ["train", *words, "--help"])
    cli.run(lambda config, overrides: None, "train")
    assert "mine" in capsys.readouterr().out


def test_an_option_without_a_folder_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["train", "stage=balance", "--config-dir"])
    with pytest.raises(SystemExit):
        cli.run(lambda config, overrides: None, "train")
    assert capsys.readouterr().err == "skatemount.train: --config-dir: give the folder, --config-dir my_conf\n"
