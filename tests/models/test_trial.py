"""Networks and algorithms of one's own that cannot be used are one line before anything is trained."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import defaults
import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn
from torchrl.modules import ValueOperator
from torchrl.objectives import LossModule

from skatemount.losses.base import make_algorithm
from skatemount.losses.config import ALGORITHMS
from skatemount.losses.ppo import PPO
from skatemount.models.actor_critic import ActorCritic, Join
from skatemount.models.base import Networks, make_networks
from skatemount.models.config import NETWORKS
from skatemount.models.symmetry import Reflection
from skatemount.models.trial import try_networks
from skatemount.utils.errors import ConfigError

SIZES = (9, 4, 12)
PAIRS = tuple(
    Reflection(
        torch.arange(n).flip(0), torch.ones(n) if n % 2 == 0 else -torch.ones(n).index_fill(0, torch.tensor(4), -1)
    )
    for n in SIZES
)
"""Some reflection of each size."""


class Wrong(ActorCritic):
    """Networks of which a test replaces one part."""

    def __init__(self, *args: Any, **kwargs: Any):
        super().__init__(*args, **kwargs)
        self.replace()

    def replace(self) -> None: ...


class Fewer(Wrong):
    def replace(self) -> None:
        self.actor = ActorCritic(self.config, 9, 4, 11).actor


class Values(Wrong):
    def replace(self) -> None:
        self.critic = ValueOperator(Join(nn.Linear(13, 2)), in_keys=list(self.critic_keys))


class Narrow(Wrong):
    def replace(self) -> None:
        self.critic = ValueOperator(Join(nn.Linear(12, 1)), in_keys=list(self.critic_keys))


class NoName(Wrong):
    def replace(self) -> None:
        self.critic = ValueOperator(Join(nn.Linear(13, 1)), in_keys=list(self.critic_keys), out_keys=["value"])


class Sees(Wrong):
    actor_keys = ("obs",)


class Peeks(Wrong):
    """The actor reads what only the critic may see."""

    def replace(self) -> None:
        self.actor = ActorCritic(self.config, 13, 4, 12).actor
        self.actor.module[0].in_keys = ["privileged"]


class Bare(Wrong):
    def replace(self) -> None:
        self.actor = nn.Linear(9, 12)


class Fails(Wrong):
    def replace(self) -> None:
        raise KeyError("no such layer")


class Remembers(Wrong):
    state_keys = ("memory",)


class Unprepared(Wrong):
    def prepare(self, batch: TensorDictBase) -> Any:
        return batch.select("observation")


class Plain(Networks):
    """Not symmetric, whatever the settings say; the last layer begins with zeros, so new networks are."""

    def __init__(
        self,
        config: Any,
        observation: int,
        privileged: int,
        actions: int,
        reflections: tuple[Reflection, Reflection, Reflection] | None = None,
    ):
        super().__init__(config, observation, privileged, actions, reflections)
        inner = ActorCritic(defaults.network(actor=[8], critic=[8]), observation, privileged, actions)
        self.actor, self.critic = inner.actor, inner.critic
        with torch.no_grad():
            for name, each in self.named_parameters():
                if ".2." in name or ".1.2" in name:
                    each.zero_()


class Own(ActorCritic):
    """Good networks by another name."""


@pytest.fixture(autouse=True)
def registered() -> Iterator[None]:
    saved = [(each, each.snapshot()) for each in (NETWORKS, ALGORITHMS)]
    for cls in (Fewer, Values, Narrow, NoName, Sees, Peeks, Bare, Fails, Remembers, Unprepared, Plain, Own):
        NETWORKS.register(cls.__name__.lower())(cls)
    for algorithm in (NoLoss, NoArguments, NoCritic, Keyless, Broken, Good):
        ALGORITHMS.register(algorithm.__name__.lower())(algorithm)
    yield
    for registry, before in saved:
        registry.restore(before)


def networks(kind: str, symmetric: bool = False) -> Networks:
    config = defaults.network(kind=kind, symmetric=symmetric, actor=[8], critic=[8])
    return make_networks(config, *SIZES, PAIRS if symmetric else None)  # type: ignore[arg-type]


def one_line(error: pytest.ExceptionInfo[ConfigError]) -> str:
    text = str(error.value)
    assert "\n" not in text
    return text


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        (
            "fewer",
            f"actor of Fewer of {__name__} wrote float32 of shape [5, 11] as loc; it must write float32 of shape ",
        ),
        (
            "values",
            f"critic of Values of {__name__} wrote float32 of shape [5, 2] as state_value; it must write float32",
        ),
        (
            "narrow",
            f"critic of Narrow of {__name__} failed when tried with 5 worlds: RuntimeError: mat1 and mat2 shapes",
        ),
        (
            "noname",
            f"critic of NoName of {__name__} wrote nothing as state_value; it must write float32 of shape [5, 1]",
        ),
        ("sees", f"actor_keys of Sees of {__name__} has 'obs'; they can be observation and privileged"),
        ("peeks", f"actor of Peeks of {__name__} failed when tried with 5 worlds: KeyError: "),
        ("bare", f"actor of Bare of {__name__} failed when tried with 5 worlds: TypeError: "),
        ("fails", f"Fails of {__name__} cannot be made: KeyError: 'no such layer' ({__file__}, line "),
        (
            "remembers",
            f"actor of Remembers of {__name__} wrote nothing as next.memory; it must write float32 of shape [5",
        ),
    ],
)
def test_a_network_that_cannot_be_used_is_one_line(kind: str, said: str) -> None:
    with pytest.raises(ConfigError) as error:
        networks(kind)
    assert one_line(error).startswith(f"network.kind={kind}: {said}")


def test_a_network_that_is_not_symmetric_is_one_line_that_says_what_to_do() -> None:
    networks("plain")
    with pytest.raises(ConfigError) as error:
        networks("plain", symmetric=True)
    assert one_line(error).startswith(
        f"network.symmetric=true: Plain of {__name__} (network.kind=plain) does not give the mirrored action"
    )
    assert "use network.symmetric=false, or build its layers from `reflections`" in str(error.value)


def test_a_symmetric_network_passes_and_nothing_changes() -> None:
    torch.manual_seed(0)
    made = networks("own", symmetric=True)
    after = torch.rand(1)
    before = {name: value.clone() for name, value in made.state_dict().items()}
    torch.manual_seed(0)
    plain = networks("mlp", symmetric=True)
    # Own networks begin with the same weights as the package's, and draw nothing that the package's do not draw.
    assert torch.equal(after, torch.rand(1))
    assert all(torch.equal(value, before[name]) for name, value in plain.state_dict().items())
    try_networks(plain, PAIRS)  # type: ignore[arg-type]
    assert all(torch.equal(value, before[name]) for name, value in plain.state_dict().items())


def test_the_description_of_a_network_is_true() -> None:
    assert networks("mlp").description == "actor [8]"
    assert networks("own").description == "network own, actor [8]"
    plain = networks("plain")
    assert plain.description == f"network plain ({sum(each.numel() for each in plain.parameters())} weights)"


class NoLoss(PPO):
    def make_loss(self, actor: Any, critic: Any) -> Any:
        return lambda batch: {}


class NoArguments(PPO):
    def make_loss(self) -> Any:  # type: ignore[override]
        return None


class NoCritic(PPO):
    def make_loss(self, actor: Any, critic: Any) -> LossModule:
        class Only(LossModule):
            def forward(self, tensordict: Any) -> Any:
                return TensorDict({"loss_objective": torch.zeros(())}, [])

        return Only()


class Keyless(PPO):
    loss_keys = (*PPO.loss_keys, "loc_of_old")


class Broken(PPO):
    def loss_metrics(self, means: dict[str, float]) -> dict[str, float]:
        return {"Loss/mine": means["mine"]}


class Good(PPO):
    """PPO whose loss counts its calls."""

    def make_loss(self, actor: Any, critic: Any) -> LossModule:
        loss = super().make_loss(actor, critic)
        loss.register_buffer("calls", torch.zeros(()))

        def count(module: Any, given: Any) -> None:
            module.calls.add_(1)

        loss.register_forward_pre_hook(count)
        return loss


def algorithm(kind: str, of: Networks, **changes: Any) -> Any:
    return make_algorithm(defaults.algorithm(kind=kind, **changes), of, 0.04, generator=torch.Generator())


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        (
            "noloss",
            f"algorithm.kind=noloss: make_loss of NoLoss of {__name__} returned function; it must return a torchrl",
        ),
        (
            "noarguments",
            f"algorithm.kind=noarguments: NoArguments of {__name__} cannot be made: TypeError: NoArguments",
        ),
        (
            "nocritic",
            f"algorithm.kind=nocritic: the loss of NoCritic of {__name__} gives no loss_critic, only loss_obj",
        ),
        ("keyless", "algorithm.kind=keyless: learning failed when tried with 5 worlds and 2 steps: KeyError: "),
        ("broken", "algorithm.kind=broken: learning failed when tried with 5 worlds and 2 steps: KeyError: 'mine' ("),
    ],
)
def test_an_algorithm_that_cannot_learn_is_one_line(kind: str, said: str) -> None:
    with pytest.raises(ConfigError) as error:
        algorithm(kind, networks("mlp"))
    assert one_line(error).startswith(said)


def test_networks_that_cannot_be_learned_with_are_one_line() -> None:
    with pytest.raises(ConfigError) as error:
        algorithm("ppo", networks("unprepared"))
    assert one_line(error).startswith("network.kind=unprepared: learning failed when tried with 5 worlds and 2 steps: ")
    with pytest.raises(ConfigError) as error:
        algorithm("good", networks("unprepared"))
    assert one_line(error).startswith("network.kind=unprepared, algorithm.kind=good: learning failed")


def test_the_trial_of_an_algorithm_changes_nothing() -> None:
    made = networks("mlp")
    before: dict[str, Tensor] = {name: value.clone() for name, value in made.state_dict().items()}
    state = torch.get_rng_state()
    good = algorithm("good", made)
    assert float(good.loss.calls) == 0 and not good.state_dict()["optimizer"]
    assert torch.equal(state, torch.get_rng_state())
    assert all(torch.equal(value, before[name]) for name, value in made.state_dict().items())
