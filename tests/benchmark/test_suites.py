"""Which task a policy is evaluated in."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from skatemount.agent import MODULE, make_card
from skatemount.benchmark.evaluation import NUM_WORLDS
from skatemount.benchmark.suites import Trial, trial_config
from skatemount.checkpoint import save_policy
from skatemount.config import Config, compose, to_dict
from skatemount.envs.task import MountTask
from skatemount.errors import ConfigError
from skatemount.models import ActorCritic

TRAINED = [
    "observation=compact",
    "robot.kp=28",
    "physics.timestep=0.005",
    "physics.threads=7",
    "physics.num_worlds=5000",
    "network.actor=[8]",
    "board.deck_friction=0.9",
    "start.x=[-0.01,0.01]",
]


@pytest.fixture(scope="module")
def policy() -> Config:
    return compose("balance", TRAINED)


def test_without_suite_it_is_what_the_policy_was_trained_in(policy: Config) -> None:
    trial, expected = to_dict(trial_config(policy, None)), to_dict(policy)
    # Except for what belongs to the machine.
    expected["physics"] |= {"threads": 0, "num_worlds": NUM_WORLDS}
    assert trial == expected


def test_a_suite_sets_the_task_and_keeps_what_is_the_policys(policy: Config) -> None:
    trial, stage = trial_config(policy, "unfixed"), compose("unfixed")
    assert (trial.start, trial.board, trial.reward) == (stage.start, stage.board, stage.reward)
    assert (trial.episode_length, trial.stage.name) == (6.0, "unfixed")
    assert (trial.robot, trial.observation) == (policy.robot, policy.observation)
    assert (trial.network, trial.physics.timestep) == (policy.network, 0.005)
    assert trial.physics.threads == 0


def test_overrides_come_on_top_setting_by_setting(policy: Config) -> None:
    overrides = ["start.y=[0.1,0.2]", "physics.threads=1", "physics.num_worlds=9", "~reward.alive"]
    trial = trial_config(policy, None, overrides)
    assert (trial.start.y, trial.start.x) == ([0.1, 0.2], [-0.01, 0.01])
    assert (trial.physics.threads, trial.physics.num_worlds) == (1, 9)
    assert "alive" not in trial.reward
    assert trial.robot.kp == 28
    # One that repeats a default counts too, where the policy's setting is another.
    assert trial_config(policy, None, ["robot.kp=35"]).robot.kp == 35


def test_a_group_is_taken_whole_as_the_stage_composes_it(policy: Config) -> None:
    longboard = trial_config(policy, None, ["board=longboard", "board.mass=4"]).board
    assert longboard == compose(None, ["board=longboard", "board.mass=4"]).board
    start = trial_config(policy, "unfixed", ["start=near"]).start
    assert (start.x, start.board_fixed) == ([-1.0, 1.0], 0.0)


def test_a_policy_without_commands_gets_none_elsewhere() -> None:
    blind = compose("mount", ["command=zero"])
    assert trial_config(blind, "approach").command.mode == "zero"
    assert trial_config(blind, "approach", ["command=board"]).command.mode == "board"


def test_the_policys_configuration_is_left_alone(policy: Config) -> None:
    before = to_dict(policy)
    trial_config(policy, "gait", ["robot.kp=20", "observation.noise=false"])
    assert to_dict(policy) == before


@pytest.mark.parametrize(
    ("suite", "override", "said"),
    [
        ("walk", "seed=1", "suite=walk is not a suite; there are: approach, balance, "),
        (None, "+stage=mount", "+stage=mount: a policy brings its own stage; give suite=<name>"),
        (None, "+experiment=paper", "give the settings themselves"),
        (None, "start.z=[0,1]", "start.z"),
        (None, "start.x=[1,0]", "start.x"),
    ],
)
def test_mistakes_are_one_line(policy: Config, suite: str, override: str, said: str) -> None:
    with pytest.raises(ConfigError) as error:
        trial_config(policy, suite, [override])
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_a_policy_that_does_not_fit_is_refused(policy: Config, tmp_path: Path) -> None:
    task = MountTask(config=policy)
    mdp = task.make_mdp(torch.Generator())
    networks = ActorCritic(policy.network, mdp.observation.size, mdp.privileged.size)
    path = tmp_path / "p.safetensors"
    save_policy(path, {MODULE: networks}, make_card(policy, task, 77))
    asked = compose(None, [f"checkpoint={path}", "suite=mount"])

    trial = Trial.prepare(asked, [f"checkpoint={path}", "suite=mount", "start.x=[0,0]"])
    described = trial.describe()
    assert described["overrides"] == ["start.x=[0,0]"]
    assert (described["stage"], described["suite"], described["frames"]) == ("balance", "mount", 77)
    with pytest.raises(ConfigError, match="its actions have scale="):
        Trial.prepare(asked, ["robot.action_scale_hip=0.5"])
