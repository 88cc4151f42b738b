"""Two policies that take turns: the one that acts, and the errors for policies that do not fit together."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from tensordict import TensorDict

from skatemount.agents.switching import MARGIN, SwitchingAgent, SwitchingPolicy
from skatemount.agents.trained_policy import MODULE, TrainedPolicy, make_policy_card
from skatemount.config import TrainConfig, compose, compose_program
from skatemount.envs import MountTask
from skatemount.envs.mount_env import MountEnv
from skatemount.evaluation.suite_task import EvaluationTask
from skatemount.models.actor_critic import ActorCritic
from skatemount.runs.checkpoint import save_policy
from skatemount.utils.errors import ConfigError


class Always:
    """A policy with one constant action, for observations of one size."""

    def __init__(self, value: float, size: int):
        self.value, self.size = value, size

    def actor(self, seen: TensorDict) -> TensorDict:
        assert seen["observation"].shape[1] == self.size
        return seen.set("action", torch.full((*seen.shape, 12), self.value))

    def actor_in(self, env: Any) -> Callable[[TensorDict], TensorDict]:
        return self.actor


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Save two policies that fit each other, one that reads more and one that reads less."""
    folder = tmp_path_factory.mktemp("policies")
    observations = {"walk": "default", "mount": "default", "past": "history", "blind": "compact"}
    for seed, (name, observation) in enumerate(observations.items()):
        config: TrainConfig = compose(
            "unfixed", ["network.actor=[8]", "network.critic=[8]", f"observation={observation}"]
        )
        task = MountTask(config=config)
        mdp = task.make_mdp(torch.Generator())
        torch.manual_seed(seed)
        networks = ActorCritic(config.network, mdp.observation.size, mdp.privileged.size, mdp.context.layout.num_joints)
        save_policy(folder / f"{name}.safetensors", {MODULE: networks}, make_policy_card(config, task, seed))
    return folder


def pair(folder: Path, first: str = "walk", second: str = "mount") -> str:
    return f"{folder / first}.safetensors+{folder / second}.safetensors"


def test_the_nearer_the_board_the_later_policy(make_env) -> None:
    env: MountEnv = make_env("unfixed", 4)
    seen = env.reset()
    size = seen["observation"].shape[1]
    walk, mount = Always(1.0, 5), Always(2.0, size)
    policy = SwitchingPolicy(walk, mount, torch.arange(5), switch_distance=0.6)
    act = policy.actor_in(env)

    def acting(*distances: float) -> list[float]:
        env.episode.distance = torch.tensor(distances)
        return act(seen.clone())["action"][:, 0].tolist()

    assert acting(2.0, 0.61, 0.59, 0.1) == [1, 1, 2, 2]
    # Within the margin, the policy that acts keeps acting.
    between = 0.6 + MARGIN / 2
    assert acting(between, between, between, between) == [1, 1, 2, 2]
    assert acting(0.5, 2.0, 2.0, 0.3) == [2, 1, 1, 2]
    # An actor for another round starts with the walking policy again.
    act = policy.actor_in(env)
    assert acting(between, between, between, between) == [1, 1, 1, 1]


@pytest.mark.parametrize(("first", "second"), [("walk", "mount"), ("walk", "past"), ("blind", "mount")])
def test_a_pipeline_is_evaluated_as_one_policy(folder: Path, first: str, second: str) -> None:
    asked = [
        f"pipeline={pair(folder, first, second)}",
        "suite=approach-unfixed",
        "episode_length=1",
        "physics.num_worlds=4",
        "observation.noise=false",
    ]

    def trial(*more: str) -> EvaluationTask:
        (made,) = EvaluationTask.prepare(compose_program("evaluate", [*asked, *more]), [*asked, *more])
        return made

    def energy(tried: EvaluationTask) -> list[float]:
        return tried.evaluate(4).records.metrics["energy"].tolist()

    # Without noise, whose random numbers depend on the size of the observation, the robots do the same.
    alone = [
        EvaluationTask.of(TrainedPolicy.load(str(folder / f"{n}.safetensors")), trial().suite, trial().overrides)
        for n in (first, second)
    ]
    assert energy(trial("switch_distance=0.01")) == energy(alone[0])
    assert energy(trial("switch_distance=100")) == energy(alone[1])
    assert energy(alone[0]) != energy(alone[1])
    again = trial("switch_distance=0.3")
    assert again.describe()["checkpoint"] == f"{first}+{second}"
    words = shlex.split(again.record_command(3))
    assert (
        f"pipeline={pair(folder, first, second)}" in words and "switch_distance=0.3" in words and "episode=3" in words
    )


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        ("gait", "pipeline=gait must be two policies, WALK+MOUNT"),
        ("a+b+c", "must be two policies"),
        ("+b", "must be two policies"),
        ("balance+nothing", "pipeline=balance+nothing: nothing: not found"),
    ],
)
def test_mistakes_are_one_line(spec: str, said: str) -> None:
    with pytest.raises(ConfigError) as error:
        SwitchingAgent.load_pair(spec, 0.6)
    assert said in str(error.value) and "\n" not in str(error.value)


def test_the_walking_policy_must_not_read_more(folder: Path) -> None:
    with pytest.raises(ConfigError, match=r"it reads observation.command \(size=3.*blind.safetensors gives nothing"):
        SwitchingAgent.load_pair(pair(folder, "walk", "blind"), 0.6)


def test_switch_distance_is_positive() -> None:
    with pytest.raises(ConfigError, match="switch_distance=-1.0 must be above 0"):
        compose_program("evaluate", ["switch_distance=-1"])
