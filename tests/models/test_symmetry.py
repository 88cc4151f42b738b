"""Symmetric networks: the image of a state gives the image of the action and the same value, after training too."""

from __future__ import annotations

import copy

import defaults
import pytest
import torch
from tensordict import TensorDict
from torch import nn
from torch.autograd import grad

from skatemount.losses.ppo import PPO
from skatemount.models.actor_critic import ActorCritic
from skatemount.models.symmetry import EquivariantLinear, EquivariantMLP, Reflection

OBSERVATION = Reflection(torch.tensor([0, 2, 1, 3, 5, 4]), torch.tensor([1.0, -1, -1, 1, 1, 1]))
PRIVILEGED = Reflection(torch.arange(3), torch.tensor([1.0, -1, 1]))
ACTION = Reflection(torch.tensor([1, 0, 3, 2]), torch.tensor([-1.0, -1, 1, 1]))


def make(symmetric: bool = True, seed: int = 0) -> ActorCritic:
    torch.manual_seed(seed)
    config = defaults.network(actor=[32, 16], critic=[32], symmetric=symmetric)
    return ActorCritic(config, 6, 3, 4, (OBSERVATION, PRIVILEGED, ACTION))


def experience(networks: ActorCritic, seed: int) -> TensorDict:
    """Return one-step episodes with a reward that differs between left and right."""
    torch.manual_seed(seed)
    n, t = 64, 8
    batch = TensorDict(batch_size=[n, t])
    for key, size in (("observation", 6), ("privileged", 3)):
        batch[key] = 3.0 * torch.randn(n, t, size) + 1.0
        batch["next", key] = batch[key].clone()
    with torch.no_grad():
        networks.actor(batch)
    batch["next", "reward"] = batch["action"][..., :1] + batch["action"][..., 1:2] + batch["action"][..., 2:3]
    over = torch.ones(n, t, 1, dtype=torch.bool)
    batch["next", "terminated"], batch["next", "done"] = over, over.clone()
    return batch


def asymmetry(networks: ActorCritic) -> tuple[float, float, float]:
    """Return the largest differences between the outputs for reflected states and the reflected outputs.

    They are those of the actions' means, their standard deviations, and the values.
    """
    torch.manual_seed(99)
    batch = TensorDict({"observation": torch.randn(50, 6) + 1, "privileged": torch.randn(50, 3) + 1}, [50])
    image = TensorDict(
        {"observation": OBSERVATION(batch["observation"]), "privileged": PRIVILEGED(batch["privileged"])}, [50]
    )
    with torch.no_grad():
        a, b = (networks.actor.get_dist(rows).base_dist for rows in (batch, image))
        v, w = (networks.critic(rows)["state_value"] for rows in (batch, image))
    deviations = a.scale[:, ACTION.permutation] - b.scale
    return float((ACTION(a.loc) - b.loc).abs().max()), float(deviations.abs().max()), float((v - w).abs().max())


def trained(networks: ActorCritic) -> ActorCritic:
    settings = defaults.algorithm(learning_rate=5e-3, target_kl=None, epochs=2)
    ppo = PPO(settings, networks, 0.04, generator=torch.Generator().manual_seed(7))
    for i in range(8):
        ppo.update(experience(networks, i))
    return networks


def test_training_leaves_them_symmetric() -> None:
    before = make()
    start = [p.clone() for p in before.parameters()]
    after = trained(before)
    assert any(not torch.equal(a, b) for a, b in zip(start, after.parameters()))
    assert max(asymmetry(after)) < 1e-5
    assert min(asymmetry(trained(make(symmetric=False)))) > 1e-3


def test_a_reward_without_a_side_is_learned() -> None:
    """Two mirrored actions cannot follow a reward that wants them to differ; the third action can follow its own."""
    after = trained(make())
    with torch.no_grad():
        means = after.actor.get_dist(experience(after, 50).flatten(0, 1)).base_dist.loc.mean(0)
    assert float(means[2]) > 0.1 < float(means[3])


def test_normalizers_observe_both_sides() -> None:
    networks = make()
    batch = experience(networks, 0)
    networks.observe(batch)
    seen = torch.cat((batch["observation"], OBSERVATION(batch["observation"]))).flatten(0, 1)
    torch.testing.assert_close(networks.normalizers[0].mean, seen.mean(0))
    torch.testing.assert_close(networks.normalizers[0].var, seen.var(0, correction=0))


def test_weights_bring_their_mirror_images() -> None:
    networks = trained(make())
    bare = ActorCritic(networks.config, 6, 3, 4)
    bare.load_state_dict(networks.state_dict())
    assert asymmetry(bare) == asymmetry(networks)
    bare.observe(experience(bare, 3))
    assert max(asymmetry(bare)) < 1e-5


@pytest.mark.parametrize("after", [Reflection.paired(8), Reflection.identity(8)])
def test_layer_starts_as_wide_as_a_plain_one(after: Reflection) -> None:
    """The initial weights have the spread of a plain layer's, although each is a mean of two."""
    torch.manual_seed(0)
    size = 400
    plain = torch.nn.Linear(size, 8).weight.detach().std()
    layer = EquivariantLinear(Reflection.paired(size), after)
    with torch.no_grad():
        own = (layer(torch.eye(size)) - layer(torch.zeros(1, size))).std()
    assert float(own / plain) == pytest.approx(1.0, rel=0.1)


@pytest.mark.parametrize("after", [ACTION, Reflection.identity(1)])
def test_even_and_odd_parts_give_what_whole_layers_give(after: Reflection) -> None:
    torch.manual_seed(0)
    mlp = EquivariantMLP(OBSERVATION, after, [8, 4], torch.nn.ELU)
    x, y = torch.randn(2, 50, 6, requires_grad=True), torch.randn(2, 50, len(after.signs))
    expected = nn.Sequential.forward(mlp, x)
    torch.testing.assert_close(mlp(x), expected)
    values = [x, *mlp.parameters()]
    for got, due in zip(grad(mlp(x), values, y), grad(expected, values, y)):
        torch.testing.assert_close(got, due)


def test_a_copy_takes_the_mirror_images_that_it_is_given() -> None:
    plain = Reflection(torch.arange(4), torch.ones(4))
    copied = copy.deepcopy(plain)
    copied.load_state_dict(ACTION.state_dict())
    assert (plain.even_size, copied.even_size) == (4, ACTION.even_size)


@pytest.mark.parametrize("mirror", [OBSERVATION, PRIVILEGED, ACTION, Reflection.paired(6), Reflection.identity(3)])
def test_parts_of_a_vector_are_its_even_and_its_odd_part(mirror: Reflection) -> None:
    torch.manual_seed(0)
    x, w = torch.randn(2, 5, len(mirror.signs))
    both, image = mirror.to_even_odd(x), mirror.to_even_odd(mirror(x))
    assert torch.equal(image[:, : mirror.even_size], both[:, : mirror.even_size])
    assert torch.equal(image[:, mirror.even_size :], -both[:, mirror.even_size :])
    factors = torch.cat((mirror.fold_weight(w), mirror.fold_weight(w, odd=True)), 1)
    torch.testing.assert_close((both * factors).sum(-1), (x * w).sum(-1))
