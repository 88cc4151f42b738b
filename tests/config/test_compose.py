"""The configuration: every file composes, mistakes are one line, and it survives being saved."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path

import hydra
import pytest
import torch
import yaml
from composed import one_line, stage_config

import skatemount
from skatemount import config as configuration
from skatemount.config import (
    TrainConfig,
    compose,
    config_dir,
    from_dict,
    stages,
    to_dict,
)
from skatemount.config.files import choices, groups
from skatemount.envs.task import MountTask
from skatemount.runs.find import find_checkpoint
from skatemount.utils.errors import ConfigError

STAGES = list(stages())
OPTIONS = [f"{group}={name}" for group in groups("train") if group != "stage" for name in choices(group)]


@pytest.mark.parametrize("stage", STAGES)
def test_stage_composes(stage: str) -> None:
    config = stage_config(stage)
    assert config.stage.name == stage and config.stage.description == stages()[stage] != ""
    if (policy := config.stage.init_from) is not None:
        assert find_checkpoint(policy).is_file()
    MountTask(config=config)  # every term and parameter of its tables exists


def test_stages_differ_as_described() -> None:
    by_name = {name: stage_config(name) for name in STAGES}
    assert by_name["unfixed"].start.board_fixed == 0.0 and by_name["approach"].start.board_fixed == 1.0
    for name in ("approach", "unfixed"):
        start = by_name[name].start
        assert (start.x, start.y, start.both_sides) == ([-0.3, 0.3], [0.5, 1.0], True)
    mount = by_name["mount"].start
    assert (mount.x, mount.y) == ([-0.3, 0.3], [-0.3, 0.3])
    assert mount.yaw == pytest.approx([-math.pi, math.pi], abs=1e-4)
    assert by_name["anywhere"].start.distance == [0.0, 1.05] and mount.distance is None
    gait = by_name["gait"]
    assert (gait.success, gait.command.mode) == ("gait", "sampled")
    assert gait.start.x[0] > 2.0  # out of the board's reach
    assert gait.reward["track_lin_vel"].weight > 0 and gait.reward["feet_on_board"].weight == 0
    assert by_name["unfixed"].reward["board_flip"].weight > 0 and by_name["unfixed"].reward["board_speed"].weight > 0


@pytest.mark.parametrize("option", OPTIONS)
def test_every_option_of_every_group_composes(option: str) -> None:
    MountTask(config=compose(None, [option]))


def test_paper_experiment() -> None:
    config = compose("balance", ["+experiment=paper"])
    task = MountTask(config=config)
    mdp = task.make_mdp(torch.Generator())
    assert mdp.observation.size == 137
    assert mdp.context.control_step == pytest.approx(0.02)
    assert (config.physics.timestep, config.physics.substeps, config.physics.num_worlds) == (0.005, 4, 4096)
    assert config.network.actor == config.network.critic == [1024, 512, 256]
    assert (config.network.init_std, config.network.activation, config.network.normalize) == (1.0, "elu", False)
    robot = config.robot
    assert (robot.variant, robot.kp, robot.kd, robot.torque_limit, robot.speed_limit) == ("a1_isaac", 20, 0.5, 33.5, 21)
    assert (robot.action_scale_hip, robot.action_scale_thigh, robot.action_scale_calf) == (0.125, 0.25, 0.25)
    assert (robot.hip_inward, robot.thigh, robot.calf, robot.action_clip) == (0.2, 0.8, -1.5, 10)
    assert task.scene.robot.default_pose[:6] == pytest.approx([0.2, 0.8, -1.5, -0.2, 0.8, -1.5])
    assert config.reward["feet_on_board_paper"].weight == 5 and "feet_on_board" not in config.reward
    assert config.board.wheel_stiffness == 5 and config.board.truck_stiffness == 5
    ppo = config.algorithm
    assert (ppo.epochs, ppo.minibatches, ppo.clip_epsilon, ppo.entropy_coeff, ppo.critic_coeff) == (
        5,
        4,
        0.2,
        0.01,
        1.0,
    )
    assert (ppo.learning_rate, ppo.target_kl, ppo.max_grad_norm, ppo.clip_value) == (1e-3, 0.01, 1.0, True)
    assert math.exp(-0.02 / ppo.discount_horizon) == pytest.approx(0.99, abs=1e-5)
    assert math.exp(-0.02 / ppo.gae_horizon) == pytest.approx(0.95, abs=1e-5)
    assert config.collector.steps_per_env == 24


@pytest.mark.parametrize("order", [["+experiment=paper", "+stage=mount"], ["+stage=mount", "+experiment=paper"]])
def test_paper_experiment_starts_from_no_policy(order: list[str]) -> None:
    """There is none that sees what it sees."""
    assert compose(None, order).init_from is None


def test_paper_unfixed_weights() -> None:
    """The paper's flip and speed terms, and none that it does not have."""
    reward = compose("unfixed", ["+experiment=paper"]).reward
    assert (reward["board_flip"].weight, reward["board_speed"].weight, reward["board_speed"].clip) == (10, 5, 5)
    paper = compose(None, ["reward=paper"]).reward
    assert {name for name, term in reward.items() if term.weight} == {
        *(name for name, term in paper.items() if term.weight),
        "board_flip",
        "board_speed",
    }


def test_overrides() -> None:
    config = compose("mount", ["reward.mounted.weight=5", "board=longboard", "physics.num_worlds=7", "seed=3"])
    assert (config.reward["mounted"].weight, config.board.deck_length) == (5.0, 1.0)
    assert (config.physics.num_worlds, config.seed) == (7, 3)


@pytest.mark.parametrize(
    ("stage", "overrides", "expected"),
    [
        # Misspelt keys.
        ("balance", ["total_frame=5"], ["total_frame"]),
        ("balance", ["physics.num_world=5"], ["physics.num_world"]),
        ("balance", ["reward.alive.wieght=5"], ["reward.alive.wieght"]),
        ("balance", ["reward.aliv.weight=5"], ["reward.aliv"]),
        ("balance", ["observation.policy.gravity.nose=1"], ["observation.policy.gravity.nose"]),
        # Stages and options of groups that do not exist.
        ("balanse", [], ["stage=balanse", *STAGES]),
        (None, ["board=longbord"], ["board=longbord", "longboard", "mini"]),
        (None, ["+experiment=papper"], ["+experiment=papper", "paper"]),
        (None, ["gropu=default"], ["gropu"]),
        # Wrong types.
        ("balance", ["physics.num_worlds=many"], ["physics.num_worlds=many", "whole number"]),
        ("balance", ["board.truck_angle=steep"], ["board.truck_angle=steep", "a number"]),
        ("balance", ["network.actor=[a]"], ["network.actor=[a] must be a list of whole numbers such as [1, 2]"]),
        ("balance", ["network.actor=64"], ["network.actor=64", "a list"]),
        ("balance", ["reward.alive=3"], ["reward.alive"]),
        ("balance", ["seed=null"], ["seed=null", "whole number"]),
        ("balance", ["start.x=0.3"], ["start.x=0.3", "a list"]),
    ],
)  # fmt: skip
def test_mistakes_are_one_line_that_names_the_setting(
    stage: str | None, overrides: list[str], expected: list[str]
) -> None:
    with pytest.raises(ConfigError) as error:
        compose(stage, overrides)
    text = one_line(error)
    for part in expected:
        assert part in text, text


def test_negative_weight_is_one_line() -> None:
    with pytest.raises(ConfigError) as error:
        MountTask(stage="balance", overrides=["reward.lin_vel_z.weight=-0.1"])
    assert "reward.lin_vel_z.weight=-0.1 must be from 0 to 1e+06; give the size" in one_line(error)


def test_composes_while_a_hydra_application_runs(tmp_path: Path) -> None:
    (tmp_path / "other.yaml").write_text("answer: 42\n")
    with hydra.initialize_config_dir(str(tmp_path), version_base="1.3"):
        assert hydra.compose("other").answer == 42
        assert compose("gait").stage.name == "gait"
        with pytest.raises(ConfigError):
            compose("gait", ["sede=1"])
        assert hydra.compose("other").answer == 42  # and the application goes on as before


def test_survives_being_saved() -> None:
    config = compose("approach", ["logger.name=x", "start.step_height=[0,0.05]", "algorithm.target_kl=null"])
    values = to_dict(config)
    assert from_dict(values) == config
    assert from_dict(json.loads(json.dumps(values))) == config
    assert from_dict(yaml.safe_load(yaml.safe_dump(values))) == config
    assert isinstance(from_dict(values), TrainConfig)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"total_frame": 3}, "total_frame"),
        ({"physics": {"num_worlds": "many"}}, "num_worlds"),
        ({"physics": {"num_worlds": 0}}, "physics.num_worlds=0"),
        ({"reward": {"alive": {"wieght": 1}}}, "wieght"),
    ],
)
def test_saved_configuration_that_does_not_fit_is_one_line(change: dict, expected: str) -> None:
    values = to_dict(stage_config("balance"))
    for key, value in change.items():
        values[key] = {**values[key], **value} if key in values else value
    with pytest.raises(ConfigError) as error:
        from_dict(values)
    assert expected in one_line(error)


def test_a_stage_built_on_another_keeps_its_rewards_and_what_its_policy_sees() -> None:
    unfixed, anywhere = stage_config("unfixed"), stage_config("anywhere")
    assert anywhere.reward == unfixed.reward and anywhere.episode_length == unfixed.episode_length
    assert anywhere.observation == compose("unfixed", ["observation=history"]).observation != unfixed.observation
    assert compose("anywhere", ["observation=default"]).observation == unfixed.observation


def test_configuration_inside_the_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a wheel, where the groups lie in the package."""
    package = tmp_path / "site-packages" / "skatemount"
    shutil.copytree(config_dir(), package / "conf")
    file = package / "conf" / "base" / "task.yaml"
    file.write_text(file.read_text().replace("\nseed: 0 ", "\nseed: 123 "))
    monkeypatch.setattr(skatemount, "__file__", str(package / "__init__.py"))
    config_dir.cache_clear()
    assert config_dir() == package / "conf"
    assert compose("mount").seed == 123
    assert "mount" in stages()


def test_missing_configuration_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(skatemount, "__file__", str(tmp_path / "a" / "skatemount" / "__init__.py"))
    config_dir.cache_clear()
    with pytest.raises(ConfigError) as error:
        configuration.config_dir()
    assert "install skatemount again" in one_line(error)


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        (["reward.feet_proximity.params.scale=abc"], "must be of type float"),
        (["reward.feet_proximity.params.scale=0"], "must be above 0"),
        (["observation.policy.outline.params.points=0"], "points=0 must be from 1 to 1000"),
        (["reward.board_speed.params.horizontal=7"], "must be of type bool"),
        (["algorithm.learning_rate=inf"], "algorithm.learning_rate"),
        (["physics.impratio=-1"], "physics.impratio"),
        (["physics.tolerance=2"], r"physics.tolerance=2.0 must be from 0 to 1"),
        (["algorithm.minibatches=100000000"], "algorithm.minibatches"),
        (["logger.root="], "logger.root"),
    ],
)
def test_values_that_would_fail_later_are_refused_at_once(overrides: list[str], expected: str) -> None:
    with pytest.raises(ConfigError, match=expected):
        compose("balance", overrides)


def test_a_curriculum_about_the_board_is_refused_for_the_gait() -> None:
    with pytest.raises(ConfigError, match="curriculum.kind=auto"):
        compose("gait", ["+curriculum=auto"])


def test_stages_that_learn_from_scratch_switch_their_curriculum_on() -> None:
    kinds = {stage: compose(stage).curriculum.kind for stage in choices("stage")}
    assert {stage for stage, kind in kinds.items() if kind == "auto"} == {"mount", "unfixed"}
    assert compose("mount").curriculum.free_board_after is None
    for stage in ("mount", "unfixed"):
        assert compose(stage).init_from is None
        plain = compose(stage, ["curriculum=none"])
        assert (plain.curriculum.kind, plain.init_from, plain.algorithm.final_std) == ("none", "stage", None)
    assert compose("unfixed", ["experiment=paper"]).curriculum.kind == "none"


def test_a_misspelt_setting_is_answered_with_the_nearest() -> None:
    with pytest.raises(ConfigError, match="did you mean total_frames") as error:
        compose("balance", ["total_frame=10"])
    assert "append" not in str(error.value)


def test_terms_can_be_added_without_a_plus() -> None:
    assert compose("balance", ["reward.still.weight=1"]).reward["still"].weight == 1.0
