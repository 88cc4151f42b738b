"""Actor and critic: the keys that they read and write, their standard deviations and their normalizers."""

from __future__ import annotations

import dataclasses

import defaults
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from skatemount.models.actor_critic import ActorCritic
from skatemount.models.config import NetworkConfig
from skatemount.models.normalization import RunningNormalizer
from skatemount.models.symmetry import Reflection
from skatemount.utils.errors import ConfigError

SMALL = defaults.network(actor=[16, 8], critic=[12])


def make(config: NetworkConfig = SMALL, seed: int = 0) -> ActorCritic:
    torch.manual_seed(seed)
    return ActorCritic(config, observation=9, privileged=4, actions=12)


def seen(*batch: int, scale: float = 1.0) -> TensorDict:
    values = {"observation": scale * torch.randn(*batch, 9), "privileged": scale * torch.randn(*batch, 4)}
    return TensorDict(values, batch_size=batch)


def gaussian(networks: ActorCritic, batch: TensorDict) -> tuple[torch.Tensor, torch.Tensor]:
    """Return means and standard deviations of the actions."""
    with torch.no_grad():
        acted = networks.actor(batch.clone())
    return acted["loc"], acted["scale"]


def test_shapes() -> None:
    networks, batch = make(), seen(5, 3)
    acted = networks.actor(batch.clone())
    assert acted["action"].shape == acted["loc"].shape == acted["scale"].shape == (5, 3, 12)
    assert acted["action_log_prob"].shape == (5, 3)
    assert networks.critic(batch.clone())["state_value"].shape == (5, 3, 1)
    layers = [p.shape for name, p in networks.actor.named_parameters() if name.endswith("weight")]
    assert layers == [(16, 9), (8, 16), (12, 8)]
    layers = [p.shape for name, p in networks.critic.named_parameters() if name.endswith("weight")]
    assert layers == [(12, 13), (1, 12)]


def test_only_the_critic_sees_what_is_privileged() -> None:
    networks, one = make(), seen(4)
    other = one.clone()
    other["privileged"] = torch.randn(4, 4)
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        assert torch.equal(networks.actor(one.clone())["action"], networks.actor(other.clone())["action"])
        assert not torch.equal(networks.critic(one.clone())["state_value"], networks.critic(other)["state_value"])
        networks.actor(one.select("observation"))  # deployed, there are no privileged observations


def test_deterministic_actions_are_the_mean() -> None:
    networks, batch = make(), seen(6)
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        acted = networks.actor(batch.clone())
    assert torch.equal(acted["action"], acted["loc"])
    torch.testing.assert_close(gaussian(networks, batch)[0], acted["loc"])
    with torch.no_grad():
        explored = networks.actor(batch.clone())
    assert not torch.equal(explored["action"], acted["action"])  # exploring is what happens unless asked not to


def test_log_probability_is_that_of_the_normal_distribution() -> None:
    networks, batch = make(), seen(6)
    acted = networks.actor(batch.clone())
    z = (acted["action"] - acted["loc"]) / acted["scale"]
    expected = (-0.5 * z.square() - acted["scale"].log() - 0.5 * torch.log(torch.tensor(2 * torch.pi))).sum(-1)
    torch.testing.assert_close(acted["action_log_prob"], expected)


@pytest.mark.parametrize("seed", range(3))
def test_first_actions_are_near_the_default_pose(seed: int) -> None:
    """A few hundredths of the action scale, for any observation."""
    networks = make(defaults.network(), seed)
    networks.observe(seen(50, 10, scale=30.0))
    loc, _ = gaussian(networks, seen(200, scale=30.0))
    assert float(loc.abs().max()) < 0.05


@pytest.mark.parametrize("parameter", [-1e30, -100.0, -20.0, 0.0, 20.0, 100.0, 1e30])
def test_deviation_stays_positive_and_bounded(parameter: float) -> None:
    networks = make(dataclasses.replace(SMALL, min_std=0.05, max_std=1.0))
    for name, each in networks.actor.named_parameters():
        if each.shape == (12,) and not name.endswith("bias"):
            torch.nn.init.constant_(each, parameter)
    batch = seen(3)
    _, std = gaussian(networks, batch)
    assert bool((std >= 0.05 - 1e-6).all()) and bool((std <= 1.0 + 1e-6).all())
    assert bool(networks.actor(batch)["action_log_prob"].isfinite().all())
    assert (std[0, 0] < 0.5) == (parameter < 0) or parameter == 0


def test_normaliser_equals_the_statistics_of_all_it_has_seen() -> None:
    normalizer = RunningNormalizer(3)
    generator = torch.Generator().manual_seed(0)
    parts = [
        torch.randn(*shape, 3, generator=generator) * torch.tensor([1.0, 20.0, 1e-2]) + torch.tensor([0.0, 300.0, 5.0])
        for shape in ((4, 7), (1, 1), (50, 24), (3,))
    ]
    parts[2] += 2.0  # what is seen drifts
    for part in parts:
        normalizer.observe(part)
    everything = torch.cat([part.flatten(0, -2) for part in parts]).double()
    assert (normalizer.count == len(everything)).all()
    torch.testing.assert_close(normalizer.mean.double(), everything.mean(0), rtol=1e-5, atol=1e-5)
    torch.testing.assert_close(normalizer.var.double(), everything.var(0, correction=0), rtol=1e-4, atol=1e-5)
    normal = normalizer(everything.float())
    assert float(normal.mean(0).abs().max()) < 1e-3
    assert normal.std(0, correction=0)[:2].tolist() == pytest.approx([1.0, 1.0], abs=1e-3)


def test_normaliser_that_sees_more_than_the_one_it_takes_over() -> None:
    old, new, alone = RunningNormalizer(1), RunningNormalizer(3), RunningNormalizer(3)
    old.observe(torch.tensor([[1.0], [3.0]]).repeat(500_000, 1))
    new.inherit(old, torch.tensor([1]))
    generator = torch.Generator().manual_seed(0)
    for values in (torch.ones(50, 3), 8 + torch.rand(500, 3, generator=generator), torch.zeros(100, 3)):
        new.observe(values)
        alone.observe(values)
        # What is new is known from these batches alone; what was known before has seen too much to move.
        torch.testing.assert_close(new.mean[[0, 2]], alone.mean[[0, 2]])
        torch.testing.assert_close(new.var[[0, 2]], alone.var[[0, 2]])
        assert float(new.mean[1]) == pytest.approx(2.0, abs=0.01)


def test_normaliser_before_it_has_seen_anything_and_far_out() -> None:
    normalizer = RunningNormalizer(2)
    values = torch.tensor([[0.5, -2.0]])
    torch.testing.assert_close(normalizer(values), values, rtol=1e-3, atol=0)
    normalizer.observe(torch.zeros(10, 2))  # what never varies stays finite
    assert bool(normalizer(values).isfinite().all())
    assert normalizer(torch.tensor([[1e9, -1e9]])).tolist() == [[10.0, -10.0]]


def test_normaliser_is_of_the_network_and_saved_with_it() -> None:
    networks = make()
    assert len(networks.normalizers) == 2
    networks.observe(seen(64, 3, scale=5.0))
    state = networks.state_dict()
    buffers = [key for key in state if key.endswith(("mean", "var", "count"))]
    assert any(key.startswith("actor") for key in buffers) and any(key.startswith("critic") for key in buffers)
    other = make(seed=1)
    other.load_state_dict(state)
    batch = seen(4, scale=5.0)
    assert torch.equal(gaussian(other, batch)[0], gaussian(networks, batch)[0])
    assert torch.equal(other.critic(batch.clone())["state_value"], networks.critic(batch.clone())["state_value"])


def test_normaliser_does_not_learn_by_gradients_nor_by_acting() -> None:
    networks = make()
    before = [b.clone() for b in networks.buffers()]
    networks.actor(seen(8, scale=9.0))
    networks.critic(seen(8, scale=9.0))
    assert all(torch.equal(a, b) for a, b in zip(before, networks.buffers()))
    assert not {id(b) for b in networks.buffers()} & {id(p) for p in networks.parameters()}


def test_without_normaliser() -> None:
    networks = make(dataclasses.replace(SMALL, normalize=False))
    state = {key: value.clone() for key, value in networks.state_dict().items()}
    networks.observe(seen(8, scale=9.0))
    assert all(torch.equal(state[key], value) for key, value in networks.state_dict().items())


@pytest.mark.parametrize("symmetric", [False, True])
@pytest.mark.parametrize("normalize", [False, True])
def test_learners_do_what_actor_and_critic_do(symmetric: bool, normalize: bool) -> None:
    """Most inputs have a mirrored partner, so the even and odd parts differ from the inputs."""
    torch.manual_seed(0)
    swapped = torch.tensor([1, 0, 2, 4, 3, 5, 6, 8, 7]), torch.tensor([1.0, 1, -1, -1, -1, 1, 1, 1, 1])
    mirrors = Reflection(*swapped), Reflection(torch.arange(4), torch.tensor([1.0, -1, 1, -1])), Reflection.paired(12)
    config = dataclasses.replace(SMALL, normalize=normalize, symmetric=symmetric)
    networks, batch = ActorCritic(config, 9, 4, 12, mirrors), seen(20, 3, scale=2.0)
    networks.observe(batch)
    actor, critic = networks.learners()
    prepared = networks.prepare(batch)
    loc, scale = gaussian(networks, batch)
    with torch.no_grad():
        other = actor.get_dist(prepared).base_dist
        torch.testing.assert_close(other.loc, loc)
        assert torch.equal(other.scale, scale)
        torch.testing.assert_close(critic(prepared)["state_value"], networks.critic(batch)["state_value"])
    assert {id(p) for p in networks.parameters()} == {id(p) for net in (actor, critic) for p in net.parameters()}


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (dict(actor=[]), "network.actor=[]"),
        (dict(critic=[8, 0]), "network.critic=[8, 0]"),
        (dict(activation="gelu"), "network.activation=gelu must be one of elu"),
        (dict(min_std=0.0), "min_std=0.0 must be above 0"),
        (dict(init_std=0.01), "init_std=0.01"),
        (dict(max_std=0.1), "max_std=0.1"),
    ],
)
def test_bad_settings_are_one_clear_line(change: dict, expected: str) -> None:
    with pytest.raises(ConfigError) as error:
        make(dataclasses.replace(SMALL, **change))
    assert expected in str(error.value) and "\n" not in str(error.value)
