"""Saved settings of older versions: today's names, and the values that they were trained with."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

import skatemount
from skatemount.config import compose, config_dir, from_dict, to_dict
from skatemount.config.versions import ADDED, FORMAT, RENAMED, rename_override, renaming, upgrade
from skatemount.runs.shipped import ALIASES, shipped_file
from skatemount.utils.errors import ConfigError

CARDS = Path(__file__).parents[1] / "golden" / "data" / "cards"


def saved(name: str) -> dict:
    return json.loads((CARDS / f"{name}.json").read_text(encoding="utf-8"))["config"]


@pytest.mark.parametrize("card", [path.stem for path in sorted(CARDS.glob("*.json"))])
def test_a_card_of_format_1_is_read_under_todays_names(card: str) -> None:
    old = saved(card)
    config = from_dict(old)
    assert config.algorithm.discount_horizon == old["algorithm"]["horizon"]
    assert config.collector.steps_per_env == old["collector"]["steps"]
    assert config.curriculum.stuck_start_fraction == old["curriculum"].get("harvest", 0.0)
    assert to_dict(config)["format"] == FORMAT and from_dict(to_dict(config)) == config


def test_a_setting_that_did_not_exist_has_the_value_of_its_time_not_todays_default(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A balance policy of format 1 lacks 17 settings; it stays the same policy when every default changes."""
    old = saved("balance")
    missing = [key for key in ADDED if not has(upgraded_names(old), key)]
    assert "observation.history_length" in missing and "physics.tolerance" in missing
    before = from_dict(old)
    package = tmp_path / "skatemount"
    shutil.copytree(config_dir(), package / "conf")
    changes = {
        "observation/default.yaml": ("history_length: 1", "history_length: 3"),
        "physics/cpu.yaml": ("tolerance: 1.0e-8", "tolerance: 1.0e-3"),
        "algorithm/ppo.yaml": ("compile: false", "compile: true"),
    }
    for file, (value, other) in changes.items():
        text = (package / "conf" / file).read_text(encoding="utf-8")
        assert value in text
        (package / "conf" / file).write_text(text.replace(value, other), encoding="utf-8")
    monkeypatch.setattr(skatemount, "__file__", str(package / "__init__.py"))
    config_dir.cache_clear()
    try:
        assert compose("balance").observation.history_length == 3
        assert from_dict(old) == before
        assert (before.observation.history_length, before.physics.tolerance) == (1, 1e-8)
    finally:
        config_dir.cache_clear()


def upgraded_names(values: dict) -> dict:
    """Return settings of format 1 under today's names, with nothing added."""
    result = json.loads(json.dumps(values))
    for old, new in RENAMED.items():
        *groups, name = old.split(".")
        holder = result
        for group in groups:
            holder = holder.get(group, {})
        if name in holder:
            holder[new.split(".")[-1]] = holder.pop(name)
    return result


def has(values: dict, key: str) -> bool:
    for part in key.split("."):
        if not isinstance(values, dict) or part not in values:
            return False
        values = values[part]
    return True


def test_upgrading_changes_nothing_of_todays_format_and_leaves_its_input_alone() -> None:
    values = to_dict(compose("unfixed", ["curriculum=auto"]))
    again = upgrade(values)
    assert {"format": FORMAT, **again} == values and "format" in values


@pytest.mark.parametrize("robot", ["a1", "a1_isaac", "go2"])
def test_a_robot_has_the_name_of_its_file_and_keeps_its_old_one_in_what_was_saved(robot: str) -> None:
    config = compose("balance", [f"robot={robot}"])
    assert config.robot.variant == robot
    old = {"a1": "unitree", "a1_isaac": "isaac"}.get(robot, robot)
    values = to_dict(config) | {"format": 3}
    values["robot"] = values["robot"] | {"variant": old}
    assert from_dict(values) == config
    assert compose("balance", [f"robot={robot}", f"robot.variant={old}"]) == config


def test_a_command_line_may_have_old_names() -> None:
    assert rename_override("++robot.variant=unitree,go2,isaac") == "++robot.variant=a1,go2,a1_isaac"
    assert renaming("robot.variant=isaac") == "robot.variant=isaac is called robot.variant=a1_isaac now"
    assert renaming("collector.steps=3") == "collector.steps is called collector.steps_per_env now"
    assert renaming("robot.variant=a1") is None


def test_settings_of_other_programs_are_dropped_and_policies_have_their_new_names() -> None:
    old = saved("best")
    assert "episodes" in old and old["init_from"] == "pretrained:history"
    config = from_dict(old)
    assert not hasattr(config, "episodes") and config.init_from == "pretrained:unfixed-two-frames"


@pytest.mark.parametrize("found", [FORMAT + 1, 0, "2", None])
def test_an_unknown_format_is_one_line(found: object) -> None:
    with pytest.raises(ConfigError, match=rf"^saved settings: format={found!r} .*{FORMAT}"):
        from_dict(to_dict(compose("balance")) | {"format": found})


def test_every_alias_is_a_shipped_policy() -> None:
    for old, new in ALIASES.items():
        assert shipped_file(old) == shipped_file(new) is not None


def test_what_was_saved_before_there_was_sensing_sees_the_truth() -> None:
    config = compose("balance")
    values = to_dict(config) | {"format": 4}
    del values["sensing"]
    assert from_dict(values) == config and config.sensing.senses_truth
    assert from_dict(to_dict(compose("balance", ["sensing=hard"]))).sensing.board_seen == 0.7


@pytest.mark.parametrize("found", range(2, 6))
def test_what_was_saved_before_boards_varied_has_one_board_and_nominal_motors(found: int) -> None:
    values = to_dict(compose("unfixed", ["sensing=default"]))
    del values["boards"], values["randomization"]["torque_limit"]
    config = from_dict(values | {"format": found})
    assert not config.boards.vary and config.randomization.torque_limit == [1.0, 1.0]
    assert config.sensing == compose("unfixed", ["sensing=default"]).sensing


def test_what_was_saved_before_there_were_teachers_had_none() -> None:
    values = to_dict(compose("balance"))
    for name in ("teacher", "teacher_coeff", "teacher_frames"):
        del values["algorithm"][name]
    assert from_dict(values | {"format": 6}) == compose("balance")


def test_what_was_saved_before_ranks_has_their_first_defaults() -> None:
    values = to_dict(compose("balance"))
    del values["distributed"]
    config = from_dict(values | {"format": 6})
    assert (config.distributed.timeout, config.distributed.check_every) == (60.0, 10)
