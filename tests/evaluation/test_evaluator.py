"""Evaluation of an untrained policy, which keeps the default pose and stands or falls."""

from __future__ import annotations

import math

import defaults
import mujoco
import pytest
import torch

from skatemount.config import TrainConfig, compose
from skatemount.envs.mount_env import MountEnv
from skatemount.envs.task import MountTask
from skatemount.evaluation.evaluator import Evaluator, mix_seeds
from skatemount.evaluation.records import EpisodeRecords
from skatemount.evaluation.results import Evaluation
from skatemount.models.actor_critic import ActorCritic
from skatemount.utils.errors import ConfigError

SHORT = ["episode_length=2", "physics.threads=1"]
# Some of these start well on the deck, some are thrown over.
MIXED = [*SHORT, "start.x=[-0.1,0.1]", "start.ang_vel=[-1.2,1.2]"]


def make_networks(config: TrainConfig) -> ActorCritic:
    mdp = MountTask(config=config).make_mdp(torch.Generator())
    torch.manual_seed(0)
    sizes = mdp.observation.size, mdp.privileged.size
    return ActorCritic(defaults.network(actor=[8], critic=[8]), *sizes, 12)


@pytest.fixture(scope="module")
def mixed() -> tuple[TrainConfig, ActorCritic]:
    config = compose("balance", MIXED)
    return config, make_networks(config)


def evaluate(networks: ActorCritic, config: TrainConfig, episodes: int, worlds: int, seed: int = 0) -> Evaluation:
    evaluator = Evaluator(config, worlds, seed)
    result = evaluator.run(networks, episodes)
    evaluator.close()
    return result


def first_verdicts(config: TrainConfig, networks: ActorCritic, worlds: int, seed: int) -> list[bool]:
    """Return the environment's verdict at the end of each world's first episode."""
    env = MountEnv(MountTask(config=config), num_worlds=worlds, seed=mix_seeds(seed, 0))
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


def test_verdicts_are_the_environments(mixed: tuple[TrainConfig, ActorCritic]) -> None:
    config, networks = mixed
    expected = first_verdicts(config, networks, worlds=40, seed=3)
    result = evaluate(networks, config, 40, worlds=40, seed=3)
    assert 0 < sum(expected) < 40  # both verdicts occur
    assert result.successes == sum(expected)
    assert int(result.records.metrics["time_to_mount"].isfinite().sum()) == result.successes
    # What happened until then, by the same environment's own account.
    early = 1 - result.failures().get("not_mounted", 0) / 40 - result.success_rate
    assert 0 < early < 1
    assert set(result.failures()) <= {"not_mounted", "tilt", "trunk_contact", "board_tilt"}
    assert sum(result.failures().values()) == 40 - result.successes == len(result.failed_episodes())
    assert (
        (result.records.end == 0) | (result.records.metrics["feet_on_board"] == 0)
    ).all()  # ended early: no feet at all
    assert ((result.records.end == 0) == (result.records.duration == 2.0)).all()


def tensors(records: EpisodeRecords) -> list[torch.Tensor]:
    """Return every measurement, those of the task included."""
    return [value for value in vars(records).values() if isinstance(value, torch.Tensor)] + [*records.metrics.values()]


def test_an_episode_is_the_same_however_many_are_asked_for(mixed: tuple[TrainConfig, ActorCritic]) -> None:
    config, networks = mixed
    evaluator = Evaluator(config, num_worlds=6, seed=5)
    many, few = evaluator.run(networks, 15), evaluator.run(networks, 7)
    alone = evaluator.round(networks, 1)
    evaluator.close()
    assert (few.episodes, many.episodes) == (7, 15)
    assert many.records.number.tolist() == list(range(15))
    for part, rows in ((few.records, slice(0, 7)), (alone, slice(6, 12))):
        for ours, theirs in zip(tensors(part), tensors(many.records[rows]), strict=True):
            torch.testing.assert_close(ours, theirs, rtol=0, atol=0, equal_nan=True)
    # Rounds differ.
    assert not torch.equal(many.records.start[:6], many.records.start[6:12])


def test_equal_seeds_give_equal_numbers_and_others_do_not(mixed: tuple[TrainConfig, ActorCritic]) -> None:
    config, networks = mixed
    first, again = (evaluate(networks, config, 6, worlds=6, seed=7) for _ in range(2))
    assert first.to_dict() == again.to_dict()
    other = evaluate(networks, config, 6, worlds=6, seed=8)
    assert not torch.equal(other.records.start, first.records.start)


def test_mixed_seeds_do_not_meet() -> None:
    parts = [(seed, suite, number) for seed in range(20) for suite in range(10) for number in range(10)]
    seeds = {mix_seeds(*each) for each in parts}
    assert len(seeds) == len(parts)
    assert min(seeds) >= 2**31 and max(seeds) < 2**32
    assert mix_seeds(1, 2) != mix_seeds(2, 1)


def test_training_is_not_disturbed(mixed: tuple[TrainConfig, ActorCritic]) -> None:
    config, networks = mixed
    before = {k: v.clone() for k, v in networks.state_dict().items()}
    torch.set_float32_matmul_precision("medium")
    state, threads = torch.get_rng_state(), torch.get_num_threads()
    evaluate(networks, config, 4, worlds=4)
    assert (torch.get_float32_matmul_precision(), torch.get_num_threads()) == ("medium", threads)
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
        results.append(evaluate(make_networks(config), config, 4, worlds=4))
    on, beside = results
    assert (on.success_rate, on.failures()) == (1.0, {})
    assert on.summary("feet_on_board") == pytest.approx(4.0, abs=0.1)
    assert 0 <= on.to_dict()["time_to_mount"]["median"] < 0.6
    assert on.summary("board_displacement")["p95"] == pytest.approx(0.0, abs=1e-3)
    assert 0 < on.summary("energy") < 100
    assert (beside.success_rate, beside.summary("feet_on_board")) == (0.0, 0.0)
    assert beside.to_dict()["time_to_mount"] == {"median": None, "p95": None}
    assert beside.failures() == {"not_mounted": 4}  # it stood, but not on the board
    start = beside.failed_episodes()[0]["start"]
    assert (start["x"], start["y"], start["yaw"]) == pytest.approx((0.0, 0.8, 0.0), abs=1e-3)


def test_progress_counts_to_the_end(mixed: tuple[TrainConfig, ActorCritic]) -> None:
    config, networks = mixed
    calls: list[tuple[int, int]] = []
    evaluator = Evaluator(config, num_worlds=2)
    evaluator.run(networks, 3, progress=lambda *x: calls.append(x))
    evaluator.close()
    total = 2 * math.ceil(2.0 / 0.04)
    assert calls == sorted(calls)
    assert calls[0] == (0, total) and calls[-1] == (total, total) and (5, total) in calls


def test_lost_contacts_are_an_error_even_of_a_world_that_has_been_reset(mixed: tuple[TrainConfig, ActorCritic]) -> None:
    config, networks = mixed
    evaluator = Evaluator(config, 4)
    evaluator.env.physics._batch.warning[1, int(mujoco.mjtWarning.mjWARN_CONTACTFULL), 1] = 1
    with pytest.raises(ConfigError, match="dropped contacts"):
        evaluator.run(networks, 4)
    evaluator.run(networks, 4)
    evaluator.close()


def test_no_episodes_are_refused(mixed: tuple[TrainConfig, ActorCritic]) -> None:
    config, networks = mixed
    with pytest.raises(ConfigError, match="episodes=0"):
        evaluate(networks, config, 0, worlds=2)
