"""PPO: advantages equal a plain loop's, the learning rate adapts, bad batches change nothing, and it learns."""

from __future__ import annotations

import copy
import math
from typing import Any

import defaults
import pytest
import torch
from small_ppo import ACTIONS, STEP, collect, make, make_networks, same, weights

from skatemount.utils.errors import ConfigError


@pytest.mark.parametrize("ends", [0.0, 0.15])
def test_advantages_equal_a_plain_loop(ends: float) -> None:
    """A time-out is bootstrapped from the state in which it happened, a termination from nothing."""
    ppo = make(discount_horizon=0.5, gae_horizon=0.2)
    batch = collect(ppo.networks, ends=ends)
    if ends:
        # Both kinds, in the middle and at the end of the batch.
        for key, rows in (("terminated", (0, 1)), ("truncated", (2, 3))):
            other = "truncated" if key == "terminated" else "terminated"
            for row, step in zip(rows, (5, -1)):
                batch["next", key][row, step] = batch["next", "done"][row, step] = True
                batch["next", other][row, step] = False
        # What follows an end is a new start.
        batch["next", "observation"][[0, 2], 5] += 1.0
    reference = copy.deepcopy(ppo.networks)
    reference.observe(batch)
    with torch.no_grad():
        value = reference.critic(batch.select(*reference.critic_keys))["state_value"].squeeze(-1).double()
        after = reference.critic(batch["next"].select(*reference.critic_keys))["state_value"].squeeze(-1).double()
    ppo.update(batch)

    gamma, lmbda = math.exp(-STEP / 0.5), math.exp(-STEP / 0.2)
    reward, done, terminated = (batch["next", k].squeeze(-1).double() for k in ("reward", "done", "terminated"))
    n, t = reward.shape
    expected = torch.zeros(n, t, dtype=torch.float64)
    for world in range(n):
        running = 0.0
        for i in reversed(range(t)):
            delta = reward[world, i] + gamma * (1 - terminated[world, i]) * after[world, i] - value[world, i]
            running = delta + gamma * lmbda * (1 - done[world, i]) * running
            expected[world, i] = running
    target = batch["value_target"].squeeze(-1).double()
    torch.testing.assert_close(target, expected + value, rtol=1e-4, atol=1e-4)
    normal = (expected - expected.mean()) / expected.std()
    torch.testing.assert_close(batch["advantage"].squeeze(-1).double(), normal, rtol=1e-4, atol=1e-4)


def test_reports_what_happened() -> None:
    ppo = make()
    batch = collect(ppo.networks)
    deviation = float(batch["scale"].mean())
    metrics = ppo.update(batch)
    assert set(metrics) == {
        *(f"Loss/{n}" for n in ("surrogate", "value_function", "entropy", "clip_fraction", "kl", "learning_rate")),
        "Policy/mean_std",
    }
    assert all(math.isfinite(value) for value in metrics.values())
    assert metrics["Policy/mean_std"] == pytest.approx(deviation)
    assert metrics["Loss/kl"] > 0 and metrics["Loss/value_function"] > 0
    # Of a diagonal Gaussian, up to sampling.
    entropy = ACTIONS * (0.5 + 0.5 * math.log(2 * math.pi) + math.log(deviation))
    assert metrics["Loss/entropy"] == pytest.approx(entropy, rel=0.2)


def test_learning_rate_follows_the_kl_within_its_bounds() -> None:
    bounds = dict(min_learning_rate=1e-4, max_learning_rate=1e-2)
    for target, bound in ((1e-9, 1e-4), (1e3, 1e-2)):
        ppo = make(learning_rate=1e-3, target_kl=target, **bounds)
        seen = [ppo.update(collect(ppo.networks, seed=i))["Loss/learning_rate"] for i in range(7)]
        assert ppo.learning_rate == seen[-1] == pytest.approx(bound)
        assert (seen[0] < 1e-3) == (bound < 1e-3) and (seen[0] > 1e-3) == (bound > 1e-3)


def test_kl_is_of_the_policies_before_and_after_the_batch() -> None:
    ppo = make(learning_rate=3e-3)
    batch = collect(ppo.networks)
    # The normalizers take the batch into account first.
    ppo.networks.observe(batch)
    before = copy.deepcopy(ppo.networks)
    ppo.networks.observe = lambda batch: None  # type: ignore[method-assign]
    kl = ppo.update(batch)["Loss/kl"]
    with torch.no_grad():
        old, new = (n.actor.get_dist(batch.flatten(0, 1)).base_dist for n in (before, ppo.networks))
        expected = torch.distributions.kl_divergence(old, new).sum(-1).mean()
    assert kl == pytest.approx(float(expected), rel=1e-4)
    assert kl > 1e-4


def test_kl_of_a_large_batch_is_that_of_some_of_its_states(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = {}
    for most in (1_000_000, 100):
        monkeypatch.setattr("skatemount.losses.ppo.KL_STATES", most)
        ppo = make(learning_rate=3e-3, target_kl=None)
        seen[most] = ppo.update(collect(ppo.networks, n=64, t=12))["Loss/kl"]
    assert seen[100] != seen[1_000_000]
    assert seen[100] == pytest.approx(seen[1_000_000], rel=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("symmetric", [False, True])
def test_compiled_updates_are_the_same(symmetric: bool) -> None:
    metrics, after = [], []
    for compiled in (False, True):
        ppo = make(make_networks(symmetric=symmetric), compile=compiled, learning_rate=1e-3, target_kl=None)
        metrics.append([ppo.update(collect(ppo.networks, seed=i)) for i in range(2)][-1])
        after.append(weights(ppo.networks))
    assert metrics[1] == pytest.approx(metrics[0], rel=1e-3, abs=1e-5)
    assert after[0].keys() == after[1].keys()
    for key, value in after[0].items():
        torch.testing.assert_close(after[1][key], value, rtol=1e-3, atol=1e-4)


@pytest.mark.slow
def test_without_a_compiler_the_setting_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    torch._dynamo.reset()
    monkeypatch.setattr("torch._inductor.config.cpp.cxx", ("/nowhere/c++",))
    monkeypatch.setattr("torch._inductor.config.fx_graph_cache", False)
    ppo = make(compile=True)
    with pytest.raises(ConfigError, match=r"^algorithm\.compile=true: torch cannot compile here .*compiler"):
        ppo.update(collect(ppo.networks))


def test_exploration_narrows() -> None:
    ppo = make(final_std=0.1, std_frames=1000)
    rows = collect(ppo.networks).flatten(0, 1)

    def deviation() -> float:
        with torch.no_grad():
            return float(ppo.networks.actor.get_dist(rows).base_dist.scale.mean())

    config, first = ppo.networks.config, deviation()
    share = (first - config.min_std) / (config.max_std - config.min_std)
    ppo.step_schedules(0, 10**9)
    assert deviation() == pytest.approx(first)
    for frames, bound in ((500, math.sqrt(config.max_std * 0.1)), (2000, 0.1)):
        ppo.step_schedules(frames, 10**9)
        assert deviation() == pytest.approx(config.min_std + share * (bound - config.min_std), rel=1e-5)
    # The bound of a loaded policy does not rise again.
    other = make(copy.deepcopy(ppo.networks), final_std=0.1, std_frames=1000)
    other.step_schedules(0, 10**9)
    assert deviation() == pytest.approx(config.min_std + share * (0.1 - config.min_std), rel=1e-5)
    still = make()
    still.step_schedules(10**9, 10**9)
    assert still.networks.state_dict().keys() == ppo.networks.state_dict().keys()


def test_steps_become_small_at_the_end() -> None:
    # The KL of an update is far between the targets of before and after: the rate is raised early, lowered late.
    settings = dict(learning_rate=1e-3, target_kl=1e3, final_target_kl=1e-9, kl_anneal_fraction=0.5)
    for frames, raised in ((0, True), (500, True), (1000, False), (2000, False)):
        ppo = make(**settings)
        ppo.step_schedules(frames, 1000)
        ppo.update(collect(ppo.networks))
        assert (ppo.learning_rate > 1e-3) == raised and (ppo.learning_rate < 1e-3) != raised


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (dict(final_target_kl=0.0), r"algorithm\.final_target_kl=0\.0 must be above 0"),
        (dict(final_target_kl=0.01, target_kl=None), r"algorithm\.final_target_kl=0\.01 needs algorithm\.target_kl"),
        (
            dict(final_target_kl=0.02, target_kl=0.01),
            r"algorithm\.final_target_kl=0\.02 must be at most algorithm\.target_kl=0\.01",
        ),
        (dict(kl_anneal_fraction=1.5), r"algorithm\.kl_anneal_fraction=1\.5 must be above 0 and at most 1"),
    ],
)
def test_impossible_schedules_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        defaults.algorithm(**settings).validate()


def test_learning_rate_falls_with_the_imitation_and_follows_the_kl_afterwards() -> None:
    ppo = make(learning_rate=1e-3, min_learning_rate=1e-5, target_kl=1e9, teacher="given here", teacher_frames=100)
    ppo.teacher = lambda batch: torch.ones_like(batch["action"])
    rates = []
    for frames in (0, 50, 99.5, 100, 150):
        ppo.step_schedules(frames, 200)
        rates.append(ppo.update(collect(ppo.networks, seed=int(frames)))["Loss/learning_rate"])
    assert rates[:3] == [1e-3, 5e-4, 1e-5] and 1e-5 < rates[3] < rates[4]


def test_learning_rate_stays_without_a_target() -> None:
    ppo = make(learning_rate=2e-3, target_kl=None)
    ppo.update(collect(ppo.networks))
    assert ppo.learning_rate == 2e-3


def test_it_learns() -> None:
    """The reward is the negative squared distance of the actions from a target."""
    ppo = make(learning_rate=5e-3, target_kl=None, epochs=2, entropy_coeff=0.0)
    target = torch.tensor([0.5, -0.5, 0.5, 0.5])
    rewards = []
    for i in range(25):
        batch = collect(ppo.networks, n=64, t=8, seed=i)
        batch["next", "reward"] = -(batch["action"] - target).square().sum(-1, keepdim=True)
        batch["next", "terminated"][:] = batch["next", "done"][:] = True
        rewards.append(float(batch["next", "reward"].mean()))
        ppo.update(batch)
    # From 4 x (0.5^2 of the distance + 0.5^2 of the noise) to less than half.
    assert rewards[0] == pytest.approx(-2.0, abs=0.2)
    assert sum(rewards[-3:]) / 3 > -0.8


@pytest.mark.parametrize(
    "key",
    [("next", "reward"), "observation", "privileged", "action", ("next", "observation"), ("next", "privileged")],
    ids=str,
)
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_what_is_not_finite_changes_nothing(key: str | tuple[str, str], value: float) -> None:
    ppo = make()
    ppo.update(collect(ppo.networks))
    before = weights(ppo.networks)
    batch = collect(ppo.networks, seed=1)
    batch[key][3, 5] = value
    with pytest.raises(FloatingPointError, match=r"not finite in 1 of 16 worlds"):
        ppo.update(batch)
    assert same(before, weights(ppo.networks))
    ppo.update(collect(ppo.networks, seed=1))  # and it can go on


def test_the_first_cause_is_named() -> None:
    ppo = make()
    batch = collect(ppo.networks)
    batch["next", "reward"][1, 2] = math.nan
    batch["observation"][4, 3] = math.nan
    batch["action"][4, 3] = math.nan
    with pytest.raises(FloatingPointError, match=r"^next.reward .* first in world 1 at step 2 of the batch$"):
        ppo.update(batch)
    batch["observation"][5, 2] = math.inf
    with pytest.raises(FloatingPointError, match=r"^observation .* in 2 of 16 worlds, first in world 5 at step 2"):
        ppo.update(batch)
    name, weights_ = next(iter(ppo.networks.named_parameters()))
    with torch.no_grad():
        weights_[0] = math.nan
    with pytest.raises(FloatingPointError, match=f"^weight {name} is not finite$"):
        ppo.update(batch)


def test_loss_that_is_not_finite_changes_no_weight() -> None:
    ppo = make()
    batch = collect(ppo.networks)
    batch["next", "reward"] *= 1e38  # finite, but not its square
    before = [p.clone() for p in ppo.networks.parameters()]
    with pytest.raises(FloatingPointError, match="not finite"):
        ppo.update(batch)
    assert all(torch.equal(a, b) for a, b in zip(before, ppo.networks.parameters()))


def test_resumes_from_a_saved_state_bit_for_bit() -> None:
    order = torch.Generator().manual_seed(1)
    ppo = make(order=order, target_kl=1e3)
    ppo.update(collect(ppo.networks))
    other = make(copy.deepcopy(ppo.networks), order=order.clone_state(), target_kl=1e3)
    other.load_state_dict(copy.deepcopy(ppo.state_dict()))
    assert other.learning_rate == ppo.learning_rate != defaults.algorithm().learning_rate
    batch = collect(ppo.networks, seed=1)
    assert ppo.update(batch.clone()) == other.update(batch.clone())
    assert same(weights(ppo.networks), weights(other.networks))
    assert ppo.learning_rate == other.learning_rate


def test_bf16() -> None:
    """Matrix products are rounded, weights and advantages are not."""
    ppo, exact = make(bf16=True), make()
    batch = collect(ppo.networks)
    metrics, reference = ppo.update(batch), exact.update(collect(exact.networks))
    assert all(math.isfinite(value) for value in metrics.values())
    assert metrics["Loss/value_function"] == pytest.approx(reference["Loss/value_function"], rel=0.05)
    assert all(p.dtype == torch.float32 for p in ppo.networks.parameters())
    assert batch["advantage"].dtype == torch.float32
    assert not same(weights(ppo.networks), weights(exact.networks))  # it did round


def test_the_lowest_learning_rate_changes_a_trained_policy_little() -> None:
    """Adam's first step at the full learning rate moved a trained policy by a KL of 5."""

    def first_kl(gently: bool) -> float:
        networks = make_networks(init_std=0.1)
        ppo = make(networks, min_learning_rate=1e-5)
        if gently:
            ppo.use_min_learning_rate()
        return ppo.update(collect(networks))["Loss/kl"]

    assert first_kl(gently=True) < 0.5 * first_kl(gently=False)
