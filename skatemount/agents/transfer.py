"""How a training takes over a policy: as it is, or grown into a larger network or one that sees more."""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn

from skatemount.agents.interface import (
    ObservationLayout,
    check_actions,
    check_interface,
    feature_indices,
    observation_layout,
)
from skatemount.agents.trained_policy import MODULE, TrainedPolicy, load_weights
from skatemount.envs import MountTask
from skatemount.models.actor_critic import ActorCritic
from skatemount.models.config import NetworkConfig
from skatemount.models.normalization import RunningNormalizer
from skatemount.utils.errors import ConfigError


def load_pretrained(networks: ActorCritic, agent: TrainedPolicy, task: MountTask, may_expand: bool, where: str) -> None:
    """Put a policy into the networks of a training.

    Args:
        networks: Where to.
        agent: The policy.
        task: What is trained.
        may_expand: The networks may be larger and see more than the policy; see `expand`.
        where: What to call the policy in messages.

    Raises:
        ConfigError: It does not fit the networks or the task; the line says what is in the way.
    """
    for name in ("activation", "normalize", "symmetric"):
        _check_same(name, networks.config, agent.config.network, where, "")
    if may_expand:
        agent.to(networks.deviation.high.device)
        check_actions(agent.card, task, where)
        expand(networks, agent, observation_layout(task), where)
        return
    try:
        check_interface(agent.card, task, where)
    except ConfigError as error:
        advice = "choose for this run what it was trained with, or another init_from"
        if _sees_all_of_it(agent, task, where):
            advice += ", or init_from_expand=true, which takes it over into a run that sees more"
        raise ConfigError(f"{error}: {advice}") from error
    for name in ("actor", "critic"):
        _check_same(name, networks.config, agent.config.network, where, ", or init_from_expand=true for a larger one")
    load_weights(networks, {MODULE: agent.networks.state_dict()}, where)


def _sees_all_of_it(agent: TrainedPolicy, task: MountTask, where: str) -> bool:
    """Whether a task shows all that a policy saw, and its actions mean the same."""
    try:
        check_actions(agent.card, task, where)
        for key in ("observation", "privileged"):
            feature_indices(observation_layout(task), agent.card, key, where, "this run")
    except ConfigError:
        return False
    return True


def _check_same(name: str, config: NetworkConfig, old: NetworkConfig, where: str, otherwise: str) -> None:
    theirs, ours = getattr(old, name), getattr(config, name)
    if theirs != ours:
        raise ConfigError(
            f"{where}: its network has {name}={theirs}, this run's {name}={ours}: choose the same network, "
            f"or init_from=null{otherwise}"
        )


def expand(networks: ActorCritic, agent: TrainedPolicy, sees: ObservationLayout, where: str) -> None:
    """Put a policy into networks that are as large or larger, and see as much or more: they do what it did.

    What is new in the observation, and what new hidden units say, has weight zero at first. After Chen, Goodfellow and
    Shlens, "Net2Net: Accelerating Learning via Knowledge Transfer" (2016), with new units in place of copies.

    Args:
        networks: Where to; what is new keeps the weights that it has been made with.
        agent: The policy.
        sees: What the networks see.
        where: What to call the policy in messages.

    Raises:
        ConfigError: The policy does not fit in; the line says what is in the way.
    """
    old = agent.networks
    for name in ("actor", "critic"):
        _check_fits(name, networks.config, old.config, where)
    seen, hidden = (feature_indices(sees, agent.card, key, where, "this run") for key in ("observation", "privileged"))
    size = sum(part["size"] for part in sees if part["key"] == "observation")
    inputs = (seen, torch.cat((seen, hidden + size)))
    symmetric = networks.config.symmetric
    with torch.no_grad():
        for new_net, old_net, places in zip((networks.actor, networks.critic), (old.actor, old.critic), inputs):
            new_layers, old_layers = _layers(new_net), _layers(old_net)
            rows = [_units(n.out_features, o.out_features, symmetric) for n, o in zip(new_layers, old_layers)]
            # The outputs are no hidden units: they are in their own order.
            rows[-1] = torch.arange(old_layers[-1].out_features)
            for new, before, (entering, leaving) in zip(new_layers, old_layers, pairwise([places, *rows])):
                new.weight[leaving] = 0.0
                new.weight[leaving.unsqueeze(1), entering] = before.weight
                new.bias[leaving] = before.bias
    for normalizer, other, places in zip(networks.normalizers, old.normalizers, inputs):
        assert isinstance(normalizer, RunningNormalizer) and isinstance(other, RunningNormalizer)
        normalizer.inherit(other, places)
    networks.deviation.load_state_dict(old.deviation.state_dict())


def _check_fits(name: str, config: NetworkConfig, old: NetworkConfig, where: str) -> None:
    theirs, ours = list(getattr(old, name)), list(getattr(config, name))
    if len(theirs) != len(ours) or any(n < o for n, o in zip(ours, theirs)):
        raise ConfigError(
            f"{where}: its network has {name}={theirs}, which does not fit into this run's {name}={ours}: give as many "
            "layers, each as large or larger"
        )


def _layers(network: nn.Module) -> list[nn.Linear]:
    return [module for module in network.modules() if isinstance(module, nn.Linear)]


def _units(size: int, old: int, symmetric: bool) -> Tensor:
    """Where the old hidden units are among the new ones; in a symmetric network the second half mirrors the first."""
    units = torch.arange(old)
    return torch.where(units < old // 2, units, units - old // 2 + size // 2) if symmetric else units
