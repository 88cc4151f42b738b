"""The critic on a second thread: the same numbers as on one thread, errors come through, and no thread is left."""

from __future__ import annotations

import contextlib
import threading
from typing import Any

import pytest
import torch
from small_ppo import ACTIONS, OBSERVATION, PRIVILEGED, collect, make, make_networks, same, weights
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn

from skatemount.losses.concurrent import ConcurrentCritic
from skatemount.utils.devices import torch_threads


def updated(
    threads: int, networks: dict[str, Any], worlds: int = 16, **settings: Any
) -> tuple[dict[str, torch.Tensor], dict[str, float]]:
    ppo = make(make_networks(**networks), **settings)
    with torch_threads(threads):
        ppo.update(collect(ppo.networks, worlds))
        return weights(ppo.networks), ppo.update(collect(ppo.networks, worlds, seed=1))


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"entropy_coeff": 0.01, "clip_value": True},
        {"bf16": True},
        {"epochs": 1, "minibatches": 1},
        # Torch splits sums of more than 32,768 values over its threads.
        {"epochs": 1, "worlds": 3000},
    ],
)
@pytest.mark.parametrize("networks", [{}, {"normalize": True}])
def test_two_threads_give_the_numbers_of_one(networks: dict[str, Any], settings: dict[str, Any]) -> None:
    one, two = updated(1, networks, **settings), updated(2, networks, **settings)
    assert same(one[0], two[0]) and one[1] == two[1]


def test_the_critic_computes_on_another_thread_which_ends_with_the_update() -> None:
    ppo = make()
    seen = set()
    for module in ppo.networks.modules():
        if isinstance(module, nn.Linear) and module.out_features == 1:
            module.register_forward_hook(lambda *_: seen.add(threading.current_thread().name))
            module.register_full_backward_hook(lambda *_: seen.add(threading.current_thread().name))
    before = threading.active_count()
    with torch_threads(2):
        ppo.update(collect(ppo.networks))
        assert torch.get_num_threads() == 2
    assert any("critic" in name for name in seen) and threading.active_count() == before
    seen.clear()
    with torch_threads(1):
        ppo.update(collect(ppo.networks))
    assert seen == {threading.current_thread().name}


@pytest.mark.parametrize("when", ["forward", "backward"])
def test_an_error_of_the_critic_comes_through(when: str) -> None:
    ppo = make()
    last = [m for m in ppo.networks.modules() if isinstance(m, nn.Linear) and m.out_features == 1][-1]
    batch = collect(ppo.networks)

    def fail(*_: Any) -> None:
        if torch.is_grad_enabled() or when == "backward":
            raise ArithmeticError("broken critic")

    hook = (last.register_forward_hook if when == "forward" else last.register_full_backward_hook)(fail)
    with torch_threads(2):
        with pytest.raises(ArithmeticError, match="broken critic"):
            ppo.update(batch.clone())
        hook.remove()
        assert "Loss/kl" in ppo.update(batch.clone())


def make_critic() -> TensorDictModule:
    return TensorDictModule(nn.Linear(3, 1), in_keys=["x"], out_keys=["state_value"])


def test_other_inputs_are_computed_at_once() -> None:
    critic = ConcurrentCritic(make_critic(), contextlib.nullcontext)
    first, second = (TensorDict({"x": torch.randn(4, 3)}, [4]) for _ in range(2))
    with torch_threads(2), critic.two_threads():
        critic.start(first)
        value = critic(second.clone(False))["state_value"]
    assert torch.equal(value, critic.critic(second)["state_value"])
    assert not torch.equal(value, critic.critic(first)["state_value"])


def test_networks_that_share_weights_or_write_more_are_not_supported() -> None:
    networks = make_networks()
    actor, critic = networks.learners()
    assert ConcurrentCritic.supports(actor, critic)
    assert not ConcurrentCritic.supports(critic, critic)
    memory = TensorDictModule(nn.LSTM(OBSERVATION + PRIVILEGED, ACTIONS), in_keys=["x"], out_keys=["state_value", "h"])
    assert not ConcurrentCritic.supports(actor, memory)
