"""The settings that a policy is evaluated in, and suites with variants and members."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import pytest
import torch

from skatemount.agents.trained_policy import MODULE, TrainedPolicy, make_policy_card
from skatemount.config import TrainConfig, compose, compose_program, to_dict
from skatemount.config.suite import SuiteConfig
from skatemount.envs.task import MountTask
from skatemount.evaluation.evaluator import NUM_WORLDS
from skatemount.evaluation.suite_task import EvaluationTask, evaluation_config, load_suite
from skatemount.models.actor_critic import ActorCritic
from skatemount.runs.checkpoint import save_policy
from skatemount.utils.errors import ConfigError

TRAINED = [
    "observation=compact",
    "robot.kp=28",
    "physics.timestep=0.005",
    "physics.threads=7",
    "physics.num_worlds=5000",
    "physics.device=cuda:1",
    "physics.max_contacts=7",
    "network.actor=[8]",
    "board.deck_friction=0.9",
    "start.x=[-0.01,0.01]",
]


@pytest.fixture(scope="module")
def policy() -> TrainConfig:
    return compose("balance", TRAINED)


def test_without_suite_it_is_what_the_policy_was_trained_in(policy: TrainConfig) -> None:
    config, expected = to_dict(evaluation_config(policy, None)), to_dict(policy)
    # Except for what belongs to the machine.
    expected["physics"] |= {"threads": 0, "num_worlds": NUM_WORLDS, "device": "auto", "max_contacts": 48}
    assert config == expected


def suite(stage: str, *overrides: str, **more: Any) -> SuiteConfig:
    return SuiteConfig(name="test", stage=stage, overrides=list(overrides), **more)


def test_a_suite_sets_the_task_and_keeps_what_is_the_policys(policy: TrainConfig) -> None:
    config, stage = evaluation_config(policy, suite("unfixed")), compose("unfixed")
    assert (config.start, config.board, config.reward) == (stage.start, stage.board, stage.reward)
    assert (config.episode_length, config.stage.name) == (6.0, "unfixed")
    assert (config.robot, config.observation) == (policy.robot, policy.observation)
    assert (config.network, config.physics.timestep) == (policy.network, 0.005)
    assert config.physics.threads == 0


def test_the_user_has_the_last_word_then_the_variant_then_the_suite(policy: TrainConfig) -> None:
    changes = ["board=longboard", "episode_length=10", "start.x=[0,1]", "termination.tilt.params.degrees=9"]
    test = suite("unfixed", *changes)
    config = evaluation_config(policy, test, ["start.x=[0,2]", "board.mass=4.5"], variant=["board.deck_width=0.3"])
    assert (config.episode_length, config.start.x, config.start.y) == (10.0, [0.0, 2.0], [0.5, 1.0])
    assert (config.board.deck_length, config.board.deck_width, config.board.mass) == (1.0, 0.3, 4.5)
    assert config.termination["tilt"].params["degrees"] == 9
    # The suite's board is replaced, not mixed with the user's.
    assert evaluation_config(policy, test, ["board=mini"]).board == compose(None, ["board=mini"]).board


def test_overrides_come_on_top_setting_by_setting(policy: TrainConfig) -> None:
    overrides = ["start.y=[0.1,0.2]", "physics.threads=1", "physics.num_worlds=9", "~reward.alive"]
    config = evaluation_config(policy, None, overrides)
    assert (config.start.y, config.start.x) == ([0.1, 0.2], [-0.01, 0.01])
    assert (config.physics.threads, config.physics.num_worlds) == (1, 9)
    assert "alive" not in config.reward
    assert config.robot.kp == 28
    # One that repeats a default counts too, where the policy's setting is another.
    assert evaluation_config(policy, None, ["robot.kp=35"]).robot.kp == 35


def test_a_group_is_taken_whole_as_the_stage_composes_it(policy: TrainConfig) -> None:
    longboard = evaluation_config(policy, None, ["board=longboard", "board.mass=4"]).board
    assert longboard == compose(None, ["board=longboard", "board.mass=4"]).board
    start = evaluation_config(policy, suite("unfixed"), ["start=near"]).start
    assert (start.x, start.board_fixed) == ([-1.0, 1.0], 0.0)


def test_a_policy_without_commands_gets_none_elsewhere() -> None:
    blind = compose("mount", ["command=zero"])
    assert evaluation_config(blind, suite("approach")).command.mode == "zero"
    assert evaluation_config(blind, suite("approach"), ["command=board"]).command.mode == "board"
    # But standing still must not pass for following commands.
    assert evaluation_config(blind, suite("gait")).command.mode == "sampled"


def test_the_policys_configuration_is_left_alone(policy: TrainConfig) -> None:
    before = to_dict(policy)
    evaluation_config(policy, suite("gait"), ["robot.kp=20", "observation.noise=false"])
    assert to_dict(policy) == before


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("+stage=mount", "+stage=mount: a policy has its own stage; give suite=<name>"),
        ("+experiment=paper", "give the settings themselves"),
        ("task=gait", "a policy has its own task; give suite=<name>, or success=<name> for the criterion and metrics"),
        ("start.z=[0,1]", "start.z"),
        ("start.x=[1,0]", "start.x"),
    ],
)
def test_mistakes_are_one_line(policy: TrainConfig, override: str, said: str) -> None:
    with pytest.raises(ConfigError) as error:
        evaluation_config(policy, None, [override])
    assert said in str(error.value)
    assert "\n" not in str(error.value)


@pytest.fixture(scope="module")
def path(policy: TrainConfig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    task = MountTask(config=policy)
    mdp = task.make_mdp(torch.Generator())
    networks = ActorCritic(policy.network, mdp.observation.size, mdp.privileged.size, mdp.context.layout.num_joints)
    path = tmp_path_factory.mktemp("policies") / "p.safetensors"
    save_policy(path, {MODULE: networks}, make_policy_card(policy, task, 77))
    return path


def prepare(path: Path, *overrides: str) -> list[EvaluationTask]:
    asked = [f"checkpoint={path}", *overrides]
    return EvaluationTask.prepare(compose_program("evaluate", asked), asked)


def test_a_task_describes_itself(path: Path) -> None:
    (task,) = prepare(path, "suite=mount-fixed", "start.x=[0,0]", "episodes=7", "seed=4", "suite.seed=99")
    described = task.describe()
    assert (described["overrides"], described["seed"]) == (["start.x=[0,0]"], 4)
    assert (described["stage"], described["suite"], described["frames"]) == ("balance", "mount-fixed", 77)
    assert described["definition"]["version"] == load_suite("mount-fixed").version
    assert described["definition"]["seed"] == 99
    (own,) = prepare(path)
    assert (own.name, own.suite, own.describe()["definition"]) == ("balance", None, None)


def test_a_changed_suite_is_named_with_its_changes(path: Path) -> None:
    """Settings of the machine do not count, nor do those that the suite has itself."""
    machine = ["physics.threads=2", "physics.engine=cpu", "plugins=[]"]
    (task,) = prepare(path, "suite=mount-fixed", *machine, "sensing=ideal", "episodes=7", "seed=4")
    assert (task.changed_by, task.title) == ([], "p on mount-fixed")
    (task,) = prepare(path, "suite=mount-fixed", *machine, "start.x=[0,0]", "board=mini", "suite.seed=99")
    assert task.changed_by == ["suite.seed=99", "start.x=[0,0]", "board=mini"] == task.describe()["changed_by"]
    assert task.title == "p on mount-fixed, changed by suite.seed=99, start.x=[0,0], board=mini"
    # The command that films has them, too.
    assert "suite=mount-fixed suite.seed=99 physics.threads=2" in task.record_command(3)
    (own,) = prepare(path, "physics.num_worlds=4")
    assert own.title == "p on balance, changed by physics.num_worlds=4"


def test_a_change_of_a_suite_of_suites_that_would_be_lost_is_refused(path: Path) -> None:
    with pytest.raises(
        ConfigError, match=r"^\+\+suite.seed=9 with suite=all: its suites have settings of their own; name"
    ):
        prepare(path, "suite=all", "suite.members=[far,hold]", "++suite.seed=9")


def test_a_pipeline_and_a_checkpoint_are_one_too_many(path: Path) -> None:
    with pytest.raises(ConfigError, match=f"^checkpoint={path} with pipeline=gait.anywhere: a pipeline names both"):
        prepare(path, "pipeline=gait+anywhere")


def test_a_policy_that_does_not_fit_is_refused(path: Path) -> None:
    (task,) = prepare(path, "suite=mount-fixed", "robot.action_scale_hip=0.5")
    with pytest.raises(ConfigError, match=f"checkpoint={path}: its actions have scale="):
        task.evaluate(1)


def test_the_command_that_films_an_episode(path: Path) -> None:
    (task,) = prepare(path, "suite=rolling", "start.x=[0,0]", "episodes=7", "seed=4")
    expected = ["python", "-m", "skatemount.record", f"checkpoint={path}", "suite=rolling", "seed=4", "start.x=[0,0]"]
    assert shlex.split(task.record_command(12)) == [*expected, "episode=12"]


def test_threads_are_settings_of_an_evaluation(path: Path) -> None:
    """Both are used, and only torch's number changes the rounding, so the command that films repeats it."""
    (task,) = prepare(path, "suite=mount-fixed", "physics.threads=2", "torch_threads=2", "physics.num_worlds=4")
    assert "torch_threads=2" in shlex.split(task.record_command(0))
    used = set()
    act = task.agent.policy.actor_in
    task.agent.policy.actor_in = lambda env: lambda state: used.add(torch.get_num_threads()) or act(env)(state)
    evaluator = task.evaluator("")
    try:
        assert evaluator.env.physics.threads == 2
        evaluator.round(task.agent.policy, 0)
    finally:
        evaluator.close()
    assert used == {2}


def test_a_suite_of_suites_is_a_task_each(path: Path) -> None:
    trials = prepare(path, "suite=all", "suite.members=[far,low-friction]", "episode_length=2")
    assert [task.name for task in trials] == ["far", "low-friction"]
    assert {config.episode_length for task in trials for config in task.configs.values()} == {2.0}
    assert list(trials[0].configs) == [""]


def test_variants_take_turns_and_an_episode_is_the_same_however_many_there_are(path: Path) -> None:
    agent = TrainedPolicy.load(str(path))
    test = suite("balance", "episode_length=0.4", variants={"a": ["start.x=[0,0.01]"], "b": ["start.x=[-0.5,-0.4]"]})
    task = EvaluationTask.of(agent, test, ["physics.num_worlds=3", "physics.threads=1"])
    shares: list[tuple[float, str]] = []
    few, many = task.evaluate(5, lambda *x: shares.append(x)), task.evaluate(9)
    assert few.records.number.tolist() == list(range(5))
    assert few.records.variant.tolist() == [0, 1, 0, 1, 0]
    assert {name: part.episodes for name, part in few.by_variant().items()} == {"a": 3, "b": 2}
    assert (few.records.start[1::2, 0] < -0.3).all() and (few.records.start[::2, 0] > -0.1).all()
    columns, more = (vars(each.records) | each.records.metrics for each in (few, many))
    for name in columns.keys() - {"metrics", "time_to_mount"}:
        assert torch.equal(columns[name], more[name][:5]), name
    assert task.variant_of(3) == ("b", 1)
    assert shares == sorted(shares) and shares[-1] == (1.0, "b")
    with pytest.raises(ConfigError, match="episodes=0"):
        task.evaluate(0)


def test_the_variants_of_a_suite_have_one_task() -> None:
    mixed = SuiteConfig(name="mixed", stage="mount", variants={"a": [], "b": ["success=gait"]})
    with pytest.raises(ConfigError) as error:
        EvaluationTask.of(TrainedPolicy.load("pretrained:mount"), mixed)
    assert str(error.value) == "suite.variants: success is gait and mount; the variants must have one task"
