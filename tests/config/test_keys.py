"""Keys: which there are, what a wrong one is answered with, which has the last word, and old names."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

import pytest
from composed import one_line, stage_config

import skatemount
from skatemount.config import (
    BenchProgramConfig,
    EvaluateConfig,
    RecordConfig,
    TrainConfig,
    compose,
    compose_program,
    config_dir,
)
from skatemount.config.files import LAYERS
from skatemount.config.keys import keys
from skatemount.config.overrides import check_option, prepare
from skatemount.config.programs import PROGRAMS
from skatemount.config.search import SearchConfig
from skatemount.config.versions import RENAMED
from skatemount.envs.task import MountTask
from skatemount.utils.errors import ConfigError


def test_whole_numbers_may_have_an_exponent() -> None:
    assert compose("balance", ["total_frames=1e6", "seed=2.0", "algorithm.std_frames=2.5e6"]).total_frames == 1_000_000
    with pytest.raises(ConfigError, match=r"^total_frames=1.5 must be a whole number$"):
        compose("balance", ["total_frames=1.5"])


def test_whole_numbers_of_a_file_may_have_an_exponent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "skatemount"
    shutil.copytree(config_dir(), package / "conf")
    stage = package / "conf" / "stage" / "balance.yaml"
    stage.write_text(stage.read_text().replace("4_000_000", "3e6"))
    monkeypatch.setattr(skatemount, "__file__", str(package / "__init__.py"))
    config_dir.cache_clear()
    assert compose("balance").total_frames == 3_000_000
    stage.write_text(stage.read_text().replace("3e6", "5e6"))
    assert compose("balance").total_frames == 5_000_000  # a file that changes is read again


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("+curriculm=auto", "+curriculm=auto: there is no setting curriculm; did you mean curriculum"),
        ("+algorithm.lr=1", "+algorithm.lr=1: there is no setting algorithm.lr; did you mean algorithm.learning_rate?"),
        ("++sed=5", "++sed=5: there is no setting sed; did you mean seed"),
        ("+nope=1", "+nope=1: there is no setting nope; python -m skatemount.train --cfg job lists all"),
        ("~sed", "~sed: there is no setting sed"),
        ("+start.z=[0,1]", "+start.z=[0,1]: there is no setting start.z"),
        ("+reward.aliv.weight=1", "reward.aliv"),
        ("num_envs=4", "did you mean physics.num_worlds?"),
        ("max_iterations=100", "did you mean total_frames?"),
        ("num_steps_per_env=24", "did you mean collector.steps_per_env?"),
        ("entropy_coef=0", "did you mean algorithm.entropy_coeff?"),
        ("learning_rate=1", "did you mean algorithm.learning_rate?"),
        ("episodes=5", "episodes=5: not a setting of train, but of evaluate"),
        ("bench.rounds=5", "bench.rounds=5: not a setting of train, but of bench"),
        ("suite=far", "suite=far: not a setting of train, but of evaluate, record, play and export"),
        ("~seed", "seed is missing: give seed=<value>"),
    ],
)
def test_every_unknown_key_is_an_error(override: str, expected: str) -> None:
    with pytest.raises(ConfigError) as error:
        compose("balance", [override])
    assert expected in one_line(error)
    with pytest.raises(ConfigError):
        MountTask(stage="balance", overrides=[override])


def test_an_unknown_key_of_a_file_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "skatemount"
    shutil.copytree(config_dir(), package / "conf")
    stage = package / "conf" / "stage" / "balance.yaml"
    stage.write_text(stage.read_text() + "collector: {enough: 4.0}\n")
    monkeypatch.setattr(skatemount, "__file__", str(package / "__init__.py"))
    config_dir.cache_clear()
    with pytest.raises(ConfigError, match=r"collector.enough=4.0: there .* did you mean collector.max_mounted_time\?"):
        compose("balance")


def test_an_experiment_overrides_a_stage_and_a_stage_a_curriculum() -> None:
    """Whatever the order on the command line; a single setting overrides all three."""
    for order in (["stage=anywhere", "curriculum=auto"], ["curriculum=auto", "stage=anywhere"]):
        config = compose(None, order)
        assert config.algorithm.final_target_kl == stage_config("anywhere").algorithm.final_target_kl
        assert config.curriculum.kind == "auto"
    for order in (["experiment=gpu", "stage=unfixed"], ["stage=unfixed", "experiment=gpu"]):
        config = compose(None, [*order, "collector.steps_per_env=7"])
        assert (config.physics.engine, config.collector.steps_per_env) == ("warp", 7)


def test_a_plus_before_a_group_changes_nothing() -> None:
    plain = compose(None, ["stage=unfixed", "curriculum=auto", "experiment=gpu"])
    assert compose(None, ["+stage=unfixed", "+curriculum=auto", "+experiment=gpu"]) == plain
    assert compose("unfixed", ["+board=mini"]) == compose("unfixed", ["board=mini"])


def test_old_names_of_settings_still_work() -> None:
    for old, new in RENAMED.items():
        if new in keys(TrainConfig):
            value = {"algorithm.final_kl": 0.001, "algorithm.settle": 0.3, "collector.enough": 2}.get(old, 0.37)
            value = {"collector.steps": 7, "curriculum.memory": 90, "grow": "true"}.get(old, value)
            value = {"curriculum.lowest": 0.001, "curriculum.least": 3, "logger.csv": "false"}.get(old, value)
            assert compose("mount", [f"{old}={value}"]) == compose("mount", [f"{new}={value}"]) != compose("mount")


def test_every_setting_has_exactly_one_default() -> None:
    """YAML has a value for each, and no dataclass has one."""
    for schema in (TrainConfig, EvaluateConfig, RecordConfig, BenchProgramConfig, SearchConfig, *PARTS):
        assert all(f.default is f.default_factory is dataclasses.MISSING for f in dataclasses.fields(schema)), schema
    for program in PROGRAMS:
        compose_program(program, [])  # nothing is missing


PARTS = [hint for hint in keys(BenchProgramConfig).values() if dataclasses.is_dataclass(hint)]


@pytest.mark.parametrize(
    ("argument", "expected"),
    [
        ("--num_envs", "settings are written without dashes: physics.num_worlds=<value>"),
        ("--task=hold", "settings are written without dashes: task=hold"),
        ("--nope", "settings are written without dashes, such as seed=1"),
        ("-seed=3", "settings are written without dashes: seed=3"),
    ],
)
def test_a_setting_with_dashes_is_named(argument: str, expected: str) -> None:
    with pytest.raises(ConfigError) as error:
        check_option(argument, "train")
    assert str(error.value) == f"{argument}: there is no such option; {expected}"


@pytest.mark.parametrize("option", ["-m", "--multirun", "--cfg", "--config-dir=mine", "-cd", "-c"])
def test_options_of_hydra_are_left_alone(option: str) -> None:
    check_option(option, "train")


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("board=lngboard", r"^board=lngboard: there is no board lngboard \(did you mean longboard\?\); there are: "),
        ("suite=nosuch", r"there are: approach-fixed"),
        ("+stage=mouunt", r"there is no stage mouunt \(did you mean mount"),
    ],
)
def test_a_wrong_choice_has_a_suggestion(override: str, expected: str) -> None:
    with pytest.raises(ConfigError, match=expected):
        prepare([override], "play" if override.startswith("suite") else "train")


LISTS: list[tuple[str, str, str | None]] = [
    ("evaluate", "suite=[far,hold]", "suite takes one name, and of a list the last would win; -m suite=far,hold runs"),
    ("record", "suite=['far', \"hold\"]", "suite takes one name, and of a list the last would win; -m suite=far,hold"),
    ("play", "suite=[far,hold]", "suite takes one name, and of a list the last would win; give one of them"),
    ("play", "suite=[]", "suite=[]: names no suite; give one, of approach-fixed"),
    ("export", "suite=[far,hold]", "of a list the last would win; suite=all has all but those of riding"),
    ("evaluate", "logger=wandb", "not a setting of evaluate, but of train, bench, search; evaluate has logger.root"),
    ("play", "board=[mini,carver]", "board takes one name, and of a list the last would win; give one of them"),
    ("evaluate", "suite=[far],[hold,far]", "suite takes one name"),
    ("evaluate", "suite=[]", "suite=[]: names no suite; give one, of all, approach-fixed"),
    ("train", "logger=[wandb,trackio]", 'several loggers are "logger.loggers=[wandb,trackio]"'),
    ("train", "+board=[mini,longboard]", "board takes one name, and of a list the last would win; -m board=mini,lon"),
    ("train", "stage=[balance,mount]", "stage takes one name"),
    ("train", "experiment=[paper,gpu,nope]", "there is no experiment nope"),
    ("train", "board=[lngboard]", "there is no board lngboard (did you mean longboard?)"),
    ("train", "board=[mini]", None),
    ("train", "board=[mini],[longboard]", None),
    ("train", "experiment=[paper,gpu]", None),
]


@pytest.mark.parametrize(("program", "override", "expected"), LISTS)
def test_a_list_of_choices_does_not_keep_its_last_one_silently(
    program: str, override: str, expected: str | None
) -> None:
    if expected is None:
        assert prepare([override], program) == [override]
        return
    with pytest.raises(ConfigError) as error:
        prepare([override], program)
    text = one_line(error)
    assert text.startswith(f"{override}: ") and expected in text, text


def test_experiments_add_up_in_a_list() -> None:
    config = compose(None, ["stage=unfixed", "experiment=[paper,gpu]"])
    assert (config.robot.variant, config.physics.engine) == ("a1_isaac", "warp")


def test_only_experiments_change_other_groups() -> None:
    """Files of these groups may be combined in a list; those of others have every setting, and the last one wins."""
    above = {path.parent.name for path in config_dir().glob("*/*.yaml") if "@package _global_" in path.read_text()}
    # A launcher changes settings of Hydra only.
    assert above - {"base", "stage", "curriculum", "task", "launcher"} == LAYERS


def test_a_part_of_a_suites_name_suggests_the_suite() -> None:
    with pytest.raises(ConfigError, match=r"there is no suite unfixed \(did you mean approach-unfixed or mount-"):
        prepare(["suite=unfixed"], "evaluate")
