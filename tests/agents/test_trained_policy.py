"""Policies loaded with their settings, and the interface between a policy and a task."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from skatemount.agents.interface import check_interface
from skatemount.agents.trained_policy import MODULE, TrainedPolicy, load_weights, make_policy_card
from skatemount.config import TrainConfig, compose
from skatemount.envs.task import MountTask
from skatemount.evaluation.suite_task import evaluation_config, load_suite
from skatemount.models.actor_critic import ActorCritic
from skatemount.runs.checkpoint import save_policy
from skatemount.utils.errors import ConfigError

TINY = ["network.actor=[8]", "network.critic=[6]", "physics.threads=1"]


def make_networks(config: TrainConfig) -> ActorCritic:
    mdp = MountTask(config=config).make_mdp(torch.Generator())
    return ActorCritic(config.network, mdp.observation.size, mdp.privileged.size, mdp.context.layout.num_joints)


@pytest.fixture(scope="module")
def config() -> TrainConfig:
    return compose("mount", [*TINY, "observation=compact"])


@pytest.fixture(scope="module")
def task(config: TrainConfig) -> MountTask:
    return MountTask(config=config)


def test_loads_what_was_saved(config: TrainConfig, task: MountTask, tmp_path: Path) -> None:
    networks = make_networks(config)
    for parameter in networks.parameters():
        torch.nn.init.normal_(parameter)
    networks.normalizers[0].observe(torch.randn(50, 75))
    card = make_policy_card(config, task, frames=1234, metrics={"Success/rate": 0.5})
    save_policy(tmp_path / "p.safetensors", {MODULE: networks}, card)

    agent = TrainedPolicy.load(str(tmp_path / "p.safetensors"))
    assert agent.config == config
    assert (agent.card.frames, agent.card.stage, agent.name) == (1234, "mount", "p")
    saved, loaded = networks.state_dict(), agent.networks.state_dict()
    assert saved.keys() == loaded.keys()
    assert all(torch.equal(saved[key], loaded[key]) for key in saved)
    # The actor and the list of normalizers share theirs, after loading as before.
    assert (agent.networks.normalizers[0].count == 50).all()
    check_interface(agent.card, task)


def test_a_card_has_the_sensing_of_the_training(tmp_path: Path) -> None:
    late = ["sensing=hard", "sensing.target_delay=[0.02,0.05]", "observation=onboard", "randomization=robust"]
    config = compose("mount", [*TINY, *late])
    path = tmp_path / "p.safetensors"
    save_policy(path, {MODULE: make_networks(config)}, make_policy_card(config, MountTask(config=config), 0))
    agent = TrainedPolicy.load(str(path))
    assert (agent.config.sensing, agent.config.randomization) == (config.sensing, config.randomization)
    assert agent.config.sensing.target_delay == [0.02, 0.05] and agent.config.sensing.board_seen == 0.7
    # Its own task has them, a suite does not.
    assert evaluation_config(agent.config, None).sensing == config.sensing
    assert evaluation_config(agent.config, load_suite("rolling")).sensing == compose(None).sensing


def test_a_card_without_joints_is_named(config: TrainConfig, task: MountTask, tmp_path: Path) -> None:
    card = make_policy_card(config, task, frames=0)
    del card.action["joints"]
    path = tmp_path / "p.safetensors"
    save_policy(path, {MODULE: make_networks(config)}, card)
    with pytest.raises(ConfigError, match=f"^checkpoint={path}: action.joints of its card must name the joints"):
        TrainedPolicy.load(str(path))


def test_card_says_what_is_seen_and_done(config: TrainConfig, task: MountTask) -> None:
    card = make_policy_card(config, task, frames=0)
    sizes = {"observation": 0, "privileged": 0}
    for part in card.observation:
        sizes[part["key"]] += part["size"]
    mdp = task.make_mdp(torch.Generator())
    assert sizes == {"observation": mdp.observation.size, "privileged": mdp.privileged.size}
    joint_vel = next(p for p in card.observation if p["name"] == "joint_vel")
    assert joint_vel == {"key": "observation", "name": "joint_vel", "size": 12, "scale": 0.05}
    assert card.action["joints"][:4] == ["FR_hip", "FR_thigh", "FR_calf", "FL_hip"]
    assert card.action["default_pose"][:3] == [0.15, 0.8, -1.5]
    assert card.action["control_step"] == config.physics.control_step
    assert {"torch", "mujoco"} <= card.versions.keys()


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("observation=default", "part 3 of its observation is observation.joint_pos"),
        ("observation.policy.joint_vel.scale=0.1", "size=12, scale=0.05"),
        ("observation.policy.gravity.clip=3", "clip=3.0"),
        ("++observation.policy.board_pos.params.at=ground", "params={'at': 'ground'}"),
        ("~observation.privileged.heights", "privileged.heights"),
        ("physics.substeps=2", "control_step=0.04, the task's 0.02"),
        ("robot.thigh=0.9", "default_pose="),
        ("robot.action_clip=3", "clip=6.0, the task's 3.0"),
    ],
)
def test_a_task_that_differs_is_named(config: TrainConfig, task: MountTask, override: str, said: str) -> None:
    card = make_policy_card(config, task, frames=0)
    other = MountTask(config=compose("mount", [*TINY, "observation=compact", override]))
    with pytest.raises(ConfigError) as error:
        check_interface(card, other, "init_from=x")
    assert str(error.value).startswith("init_from=x: ")
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_what_is_no_part_of_the_interface_may_differ(config: TrainConfig, task: MountTask) -> None:
    other = compose("unfixed", [*TINY, "observation=compact", "board=longboard", "robot.kp=25"])
    other.observation.noise = False
    check_interface(make_policy_card(config, task, frames=0), MountTask(config=other))


def test_weights_that_do_not_fit_are_named(config: TrainConfig) -> None:
    networks = make_networks(config)
    saved = networks.state_dict()
    key = next(k for k in saved if k.endswith("0.weight"))
    with pytest.raises(ConfigError, match=r"^x: weight .* is missing"):
        load_weights(networks, {MODULE: {k: v for k, v in saved.items() if k != key}}, "x")
    with pytest.raises(ConfigError, match=r"^x: weight more is unknown"):
        load_weights(networks, {MODULE: saved | {"more": torch.zeros(1)}}, "x")
    shape = list(saved[key].shape)
    with pytest.raises(ConfigError) as error:
        load_weights(networks, {MODULE: saved | {key: torch.zeros(3, 3)}}, "x")
    assert f"{key} has shape [3, 3], the network here needs {shape}" in str(error.value)
    with pytest.raises(ConfigError, match="holds actor; a policy of this version holds 'networks'"):
        load_weights(networks, {"actor": saved}, "x")


def test_a_missing_policy_names_the_setting() -> None:
    with pytest.raises(ConfigError, match=r"^init_from=nowhere: not found"):
        TrainedPolicy.load("nowhere", setting="init_from")
