"""Policies that are expanded into larger networks or longer observations act as before."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from tensordict import TensorDict
from tiny import SILENT, TINY
from torch import Tensor

from skatemount.agents import transfer
from skatemount.agents.interface import observation_layout
from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.config import compose
from skatemount.models.actor_critic import ActorCritic
from skatemount.training.resume import resume_config
from skatemount.training.trainer import Trainer
from skatemount.utils.errors import ConfigError

SMALL = [*TINY, *SILENT, "init_from=null", "network.actor=[16,8]", "network.critic=[12,8]"]


@pytest.fixture(scope="module", params=["true", "false"], ids=["symmetric", "plain"])
def small(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> TrainedPolicy:
    """Train a policy, and its normalizers, for a short time."""
    root = tmp_path_factory.mktemp("small")
    more = [f"network.symmetric={request.param}", "total_frames=128", f"logger.root={root}"]
    trainer = Trainer(compose("mount", [*SMALL, *more]), [])
    trainer.train()
    trainer.close()
    return TrainedPolicy.load(str(trainer.run.path))


def grown(small: TrainedPolicy, root: Path, *overrides: str, saves: bool = False) -> Trainer:
    symmetric = f"network.symmetric={str(small.config.network.symmetric).lower()}"
    given = [*SMALL, symmetric, f"logger.root={root}", f"init_from={small.path}", "init_from_expand=true", *overrides]
    trainer = Trainer(compose("mount", given), [])
    if saves:
        trainer.save({})
    trainer.close()
    return trainer


def outputs(networks: ActorCritic, seen: TensorDict) -> list[Tensor]:
    with torch.no_grad():
        distribution = networks.actor.get_dist(seen.select("observation")).base_dist
        return [distribution.loc, distribution.scale, networks.critic(seen.clone())["state_value"]]


@pytest.mark.parametrize(
    ("overrides", "new"),
    [
        ([], ""),
        (["network.actor=[20,8]", "network.critic=[12,10]"], ""),
        (["+observation.policy.off_time={}", "+observation.privileged.command={}"], "off_time"),
        (["observation.policy.joint_pos.history_length=3"], "joint_pos"),
        (["observation.history_length=2", "network.actor=[32,16]", "network.critic=[32,16]"], "gravity"),
    ],
    ids=["alike", "larger", "more terms", "more frames", "all"],
)
def test_does_what_it_did(small: TrainedPolicy, tmp_path: Path, overrides: list[str], new: str) -> None:
    trainer = grown(small, tmp_path, *overrides)
    # The training has lowered it.
    torch.set_float32_matmul_precision("highest")
    torch.manual_seed(1)
    seen, saw = {}, {}
    for key in ("observation", "privileged"):
        parts = [p for p in observation_layout(trainer.task) if p["key"] == key]
        old = {p["name"]: p["size"] for p in small.card.observation if p["key"] == key}
        values = {p["name"]: torch.randn(50, p["size"]) for p in parts}
        seen[key] = torch.cat([values[p["name"]] for p in parts], 1)
        # Of several frames, the policy saw the last.
        saw[key] = torch.cat([values[name][:, -size:] for name, size in old.items()], 1)
    before = outputs(small.networks, TensorDict(saw, [50]))
    for got, due in zip(outputs(trainer.networks, TensorDict(seen, [50])), before):
        torch.testing.assert_close(got, due, rtol=1e-4, atol=1e-5)
    assert float(before[0].std()) > 0 and float(before[2].std()) > 0

    # New inputs can be learned: its weights have a gradient.
    if new:
        at = 0
        for part in observation_layout(trainer.task):
            if part["name"] == new:
                break
            at += part["size"]
        trainer.networks.actor.get_dist(TensorDict(seen, [50]).select("observation")).mean.square().sum().backward()
        first = next(p for p in trainer.networks.actor.parameters() if p.ndim == 2)
        assert first.grad is not None and bool((first.grad[:, at] != 0).any())


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        (["network.actor=[16]"], ["actor=[16, 8]", "actor=[16]", "as many layers"]),
        (["network.critic=[10,8]"], ["critic=[12, 8]", "critic=[10, 8]", "as large or larger"]),
        (["network.activation=relu"], ["activation=elu", "activation=relu"]),
        (["observation=compact"], ["observation.command", "this run gives nothing"]),
        (["observation.policy.gravity.clip=0.5"], ["observation.gravity", "0.5"]),
        (["physics.substeps=2"], ["control_step"]),
    ],
    ids=lambda value: value[0],
)
def test_what_does_not_fit_in_is_one_line(
    small: TrainedPolicy, tmp_path: Path, overrides: list[str], expected: list[str]
) -> None:
    with pytest.raises(ConfigError) as error:
        grown(small, tmp_path, *overrides)
    text = str(error.value)
    assert text.startswith(f"init_from={small.path}: ") and "\n" not in text
    for part in expected:
        assert part in text


def test_a_grown_run_that_goes_on_knows_what_is_new(small: TrainedPolicy, tmp_path: Path) -> None:
    trainer = grown(small, tmp_path, "+observation.policy.off_time={}", saves=True)
    given = [f"resume={trainer.run.path}"]
    again = Trainer(resume_config(compose(None, given), given))
    again.close()
    before, after = (each.networks.normalizers[0] for each in (trainer, again))
    assert len(before.count.unique()) == 2  # of the new values nothing is known, of the others all
    assert torch.equal(after.count, before.count)


def test_grows_only_when_asked(small: TrainedPolicy, tmp_path: Path) -> None:
    for change in ("network.actor=[20,8]", "+observation.policy.off_time={}"):
        with pytest.raises(ConfigError, match="init_from=.*init_from_expand=true"):
            grown(small, tmp_path, "init_from_expand=false", change)


def test_growing_is_not_offered_where_it_would_not_help(small: TrainedPolicy, tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as error:
        grown(small, tmp_path, "init_from_expand=false", "observation=compact")
    assert "init_from_expand" not in str(error.value)


def test_the_observation_of_the_training_is_named(small: TrainedPolicy) -> None:
    assert transfer._observation_choice(small) == "observation=default"


@pytest.mark.parametrize(
    ("init_from", "given", "expected"),
    [
        ("go2-balance", [], "it was trained with another robot, go2, than the task's a1; give robot=go2,"),
        ("balance", ["robot=go2"], "it was trained with another robot, a1, than the task's go2; give robot=a1,"),
        ("balance", ["robot.hip_inward=0.1"], "; give robot.hip_inward=0.15, or another init_from"),
        ("balance", ["observation=compact"], ": give observation=default, or another init_from"),
    ],
)
def test_a_policy_says_with_which_robot_it_was_trained(
    init_from: str, given: list[str], expected: str, tmp_path: Path
) -> None:
    overrides = [f"init_from=pretrained:{init_from}", *TINY[:1], *TINY[4:], f"logger.root={tmp_path}", *given]
    with pytest.raises(ConfigError, match=f"^init_from=pretrained:{init_from}: ") as error:
        Trainer(compose("balance", overrides))
    # Another robot has one more way out.
    ends = (
        "init_from_other_robot=true to train that robot's policy on" if "robot, " in expected else "another init_from"
    )
    assert expected in str(error.value) and str(error.value).endswith(f", or {ends}")
    assert ("observation=" in str(error.value)) == ("observation=compact" in given)
    assert list(tmp_path.iterdir()) == []


def test_a_policy_of_another_robot_with_the_same_joints_when_asked(small: TrainedPolicy, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"another robot, a1, than the task's go2; .*init_from_other_robot=true"):
        grown(small, tmp_path, "robot=go2")

    for expand in ("init_from_expand=false", "init_from_expand=true"):
        trainer = grown(small, tmp_path, "robot=go2", "init_from_other_robot=true", expand)
        networks, theirs = trainer.networks.state_dict(), small.networks.state_dict()
        assert networks.keys() == theirs.keys()
        actor = [name for name in networks if name.startswith("actor") and name.endswith("weight")]
        assert actor and all(torch.equal(networks[name], theirs[name]) for name in actor)


def test_another_rate_of_control_is_no_other_robot(small: TrainedPolicy, tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as error:
        grown(small, tmp_path, "robot=go2", "physics.substeps=2")
    assert "init_from_other_robot" not in str(error.value)
    with pytest.raises(ConfigError, match="control_step"):
        grown(small, tmp_path, "init_from_other_robot=true", "physics.substeps=2")
