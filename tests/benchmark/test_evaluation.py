"""Evaluation of a policy, with an untrained one: it keeps the default pose, and so stands or falls."""

from __future__ import annotations

import json
import math

import pytest
import torch

from skatemount.benchmark.evaluation import Evaluation, Evaluator, evaluate_policy
from skatemount.config import Config, compose
from skatemount.envs.mount_env import MountEnv
from skatemount.envs.task import MountTask
from skatemount.errors import ConfigError
from skatemount.models import ActorCritic, NetworkConfig

SHORT = ["episode_length=2", "physics.threads=1"]
# Some of these start well on the deck, some are thrown over.
MIXED = [*SHORT, "start.x=[-0.1,0.1]", "start.ang_vel=[-1.2,1.2]"]


def make_networks(config: Config) -> ActorCritic:
    mdp = MountTask(config=config).make_mdp(torch.Generator())
    torch.manual_seed(0)
    sizes = mdp.observation.size, mdp.privileged.size
    return ActorCritic(NetworkConfig(actor=[8], critic=[8]), *sizes)


@pytest.fixture(scope="module")
def mixed() -> tuple[Config, ActorCritic]:
    config = compose("balance", MIXED)
    return config, make_networks(config)


def first_verdicts(config: Config, networks: ActorCritic, worlds: int, seed: int) -> list[bool]:
    """What the environment says at the end of each world's first episode."""
    env = MountEnv(MountTask(config=config), num_worlds=worlds, seed=seed)
    verdicts: dict[int, bool] = {}
    seen = env.reset()
    with torch.no_grad():
        while len(verdicts) < worlds:
            seen["action"] = networks.actor.get_dist(seen).mean
            seen = env.step(seen)["next"]
            for i in seen["done"].flatten().nonzero().flatten().tolist():
                verdicts.setdefault(i, bool(seen["success"][i]))
    env.close()
    return list(verdicts.values())


def test_verdicts_are_the_environments(mixed: tuple[Config, ActorCritic]) -> None:
    config, networks = mixed
    expected = first_verdicts(config, networks, worlds=40, seed=3)
    result = evaluate_policy(networks, config, episodes=40, seed=3, num_worlds=40)
    assert 0 < sum(expected) < 40  # both verdicts occur
    assert result.successes == sum(expected)
    assert len(result.times_to_mount) == result.successes


def test_counts_exactly_the_episodes_asked_for(mixed: tuple[Config, ActorCritic]) -> None:
    config, networks = mixed
    evaluator = Evaluator(config, num_worlds=8, seed=5)
    counted = [evaluator.run(networks, episodes) for episodes in (8, 11, 16)]
    assert [c.episodes for c in counted] == [8, 11, 16]
    # A longer evaluation goes on where the shorter one ended.
    assert counted[0].successes <= counted[1].successes <= counted[2].successes
    for each in counted:
        assert sum(each.ended.values()) == pytest.approx(1.0)
        assert each.successes / each.episodes <= each.ended["time_out"]
    evaluator.close()


def test_early_ends_are_named_and_count_once(mixed: tuple[Config, ActorCritic]) -> None:
    config, networks = mixed
    result = evaluate_policy(networks, config, episodes=40, seed=3, num_worlds=40)
    early = 1 - result.ended["time_out"]
    assert 0 < early < 1
    assert result.ended["tilt"] + result.ended["trunk_contact"] > 0
    # Episodes that ended early count no feet at all.
    assert result.feet_on_board <= 4 * result.ended["time_out"]


def test_equal_seeds_give_equal_numbers_and_others_do_not(mixed: tuple[Config, ActorCritic]) -> None:
    config, networks = mixed
    evaluator = Evaluator(config, num_worlds=6, seed=7)
    first, again = evaluator.run(networks, 9), evaluator.run(networks, 9)
    evaluator.close()
    elsewhere = evaluate_policy(networks, config, 9, seed=7, num_worlds=6)
    assert first.to_dict() == again.to_dict() == elsewhere.to_dict()
    other = evaluate_policy(networks, config, 9, seed=8, num_worlds=6)
    assert other.feet_on_board != first.feet_on_board


def test_training_is_not_disturbed(mixed: tuple[Config, ActorCritic]) -> None:
    config, networks = mixed
    before = {k: v.clone() for k, v in networks.state_dict().items()}
    torch.set_float32_matmul_precision("medium")
    state = torch.get_rng_state()
    evaluate_policy(networks, config, 4)
    assert torch.get_float32_matmul_precision() == "medium"
    assert torch.is_grad_enabled()
    assert torch.equal(torch.get_rng_state(), state)
    torch.set_float32_matmul_precision("highest")
    assert all(torch.equal(v, before[k]) for k, v in networks.state_dict().items())


def test_standing_on_the_deck_succeeds_and_standing_beside_it_does_not() -> None:
    still = [f"start.{name}=[0,0]" for name in ("x", "yaw", "roll", "pitch", "height")]
    still += [f"start.{name}=[0,0]" for name in ("lin_vel", "ang_vel", "joint_pos", "joint_vel")]
    still += ["randomization=none"]
    results = []
    for y in (0.0, 0.8):
        config = compose("balance", [*SHORT, *still, f"start.y=[{y},{y}]"])
        results.append(evaluate_policy(make_networks(config), config, 4))
    on, beside = results
    assert (on.success_rate, on.ended["time_out"]) == (1.0, 1.0)
    assert on.feet_on_board == pytest.approx(4.0, abs=0.1)
    assert 0 <= on.to_dict()["time_to_mount"]["median"] < 0.6
    assert (beside.success_rate, beside.feet_on_board) == (0.0, 0.0)
    assert beside.to_dict()["time_to_mount"] == {"median": None, "p95": None}
    assert beside.ended["time_out"] == 1.0  # it stood, but not on the board


def test_results_as_json_and_as_a_table() -> None:
    result = Evaluation(
        episodes=20,
        successes=0,
        feet_on_board=1.5,
        ended={"time_out": 0.75, "tilt": 0.25, "diverged": 0.0},
        evaluated={"checkpoint": "a/b", "suite": "mount"},
    )
    document = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert document["episodes"] == 20
    assert document["success"] == pytest.approx({"rate": 0, "low": 0, "high": 0.1611}, abs=5e-5)
    assert document["time_to_mount"] == {"median": None, "p95": None}
    text = result.table()
    for part in ("a/b on mount", "0.0% (95 % interval 0.0% to 16.1%)", "time out 75.0%, tilt 25.0%"):
        assert part in text
    assert "diverged" not in text


def test_quantiles_of_the_time_to_mount() -> None:
    times = [float(i) for i in range(1, 102)]
    result = Evaluation(episodes=200, successes=101, feet_on_board=2.0, times_to_mount=times)
    assert result.to_dict()["time_to_mount"] == {"median": 51.0, "p95": 96.0}
    assert result.metrics()["Evaluation/time_to_mount"] == 51.0


def test_progress_counts_to_the_end(mixed: tuple[Config, ActorCritic]) -> None:
    config, networks = mixed
    calls: list[tuple[int, int]] = []
    evaluate_policy(networks, config, 3, num_worlds=2, progress=lambda *x: calls.append(x))
    total = 2 * math.ceil(2.0 / 0.04)
    assert calls == [(i, total) for i in range(1, total + 1)]


def test_no_episodes_are_refused(mixed: tuple[Config, ActorCritic]) -> None:
    config, networks = mixed
    with pytest.raises(ConfigError, match="episodes=0"):
        evaluate_policy(networks, config, 0)
