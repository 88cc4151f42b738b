"""Start a training from a trained policy: unchanged, or expanded into larger networks or a longer observation."""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn

from skatemount import config as configuration
from skatemount.agents.interface import (
    ObservationLayout,
    check_actions,
    check_interface,
    feature_indices,
    observation_layout,
)
from skatemount.agents.trained_policy import MODULE, TrainedPolicy, load_weights
from skatemount.config.files import choices
from skatemount.envs import MountTask
from skatemount.models.actor_critic import ActorCritic
from skatemount.models.base import Networks
from skatemount.models.config import NetworkConfig
from skatemount.models.normalization import RunningNormalizer
from skatemount.utils.errors import ConfigError


def load_pretrained(
    networks: Networks,
    agent: TrainedPolicy,
    task: MountTask,
    may_expand: bool,
    where: str,
    other_robot: bool = False,
) -> None:
    """Load a policy into the networks of a training.

    Args:
        networks: Networks of the training.
        agent: The policy.
        task: Task of the training.
        may_expand: Allow networks that are larger or read more than the policy's; see `expand`.
        where: Name of the policy in messages.
        other_robot: Allow a policy of another robot with the same joints.

    Raises:
        ConfigError: It does not fit the networks or the task; the message names the difference.
    """
    try:
        check_actions(agent.card, task, where, other_robot)
    except ConfigError as error:
        instead = ", or another init_from"
        if _fits_but_for_the_robot(agent, task, where):
            instead = ", another init_from, or init_from_other_robot=true to train that robot's policy on"
        raise ConfigError(f"{error}{instead}") from error
    for name in ("kind", "params", "activation", "normalize", "symmetric"):
        _check_same(name, networks.config, agent.config.network, where, "")
    if may_expand:
        if not isinstance(networks, ActorCritic):
            raise ConfigError(
                f"{where}: init_from_expand=true needs network.kind=mlp, not {networks.config.kind}; use false"
            )
        agent.to(networks.deviation.high.device)
        expand(networks, agent, observation_layout(task), where)
        return
    try:
        check_interface(agent.card, task, where, other_robot)
    except ConfigError as error:
        choice = _observation_choice(agent)
        advice = f"give {choice or 'the observation that the policy was trained with'}, or another init_from"
        if _gives_all_inputs(agent, task, where):
            advice += ", or init_from_expand=true to extend the policy to the longer observation"
        raise ConfigError(f"{error}: {advice}") from error
    for name in ("actor", "critic"):
        _check_same(name, networks.config, agent.config.network, where, ", or init_from_expand=true for a larger one")
    load_weights(networks, {MODULE: agent.networks.state_dict()}, where)


def _observation_choice(agent: TrainedPolicy) -> str | None:
    """Return the setting that chooses the observation of a policy's training; None if no file of the group has it."""
    for name in choices("observation"):
        if configuration.compose(None, [f"observation={name}"]).observation == agent.config.observation:
            return f"observation={name}"
    return None


def _gives_all_inputs(agent: TrainedPolicy, task: MountTask, where: str) -> bool:
    """Return True if a task's observation has all inputs of a policy, and actions mean the same."""
    try:
        check_actions(agent.card, task, where)
        for key in ("observation", "privileged"):
            feature_indices(observation_layout(task), agent.card.observation, key, where, "this run")
    except ConfigError:
        return False
    return True


def _fits_but_for_the_robot(agent: TrainedPolicy, task: MountTask, where: str) -> bool:
    """Return True if the policy would fit with ``init_from_other_robot=true``."""
    try:
        check_actions(agent.card, task, where, other_robot=True)
    except ConfigError:
        return False
    return True


def _check_same(name: str, config: NetworkConfig, old: NetworkConfig, where: str, otherwise: str) -> None:
    """Raise `ConfigError` if a setting of the policy's network differs from this run's."""
    theirs, ours = getattr(old, name), getattr(config, name)
    if theirs != ours:
        raise ConfigError(
            f"{where}: the policy's network has {name}={theirs}, this run's {name}={ours}; set network.{name}={theirs} "
            f"or init_from=null{otherwise}"
        )


def expand(networks: ActorCritic, agent: TrainedPolicy, layout: ObservationLayout, where: str) -> None:
    """Load a policy into networks that are larger or read more, without changing its actions and values.

    New observation terms and the outputs of new hidden units start with weight zero. Follows Chen, Goodfellow and
    Shlens, "Net2Net: Accelerating Learning via Knowledge Transfer" (2016), but new units are not copies of old ones.

    Args:
        networks: Networks to load into. New units keep their initial weights.
        agent: The policy.
        layout: Layout of the networks' observation.
        where: Name of the policy in messages.

    Raises:
        ConfigError: The networks are smaller or read less; the message names the difference.
    """
    old = agent.networks
    # Both are of the same kind.
    assert isinstance(old, ActorCritic)
    for name in ("actor", "critic"):
        _check_fits(name, networks.config, old.config, where)
    observation, privileged = (
        feature_indices(layout, agent.card.observation, key, where, "this run") for key in ("observation", "privileged")
    )
    size = sum(entry["size"] for entry in layout if entry["key"] == "observation")
    inputs = (observation, torch.cat((observation, privileged + size)))
    symmetric = networks.config.symmetric
    with torch.no_grad():
        for new_net, old_net, indices in zip((networks.actor, networks.critic), (old.actor, old.critic), inputs):
            new_layers, old_layers = _layers(new_net), _layers(old_net)
            rows = [_units(n.out_features, o.out_features, symmetric) for n, o in zip(new_layers, old_layers)]
            # Outputs keep their order: they are not hidden units, whose halves mirror each other.
            rows[-1] = torch.arange(old_layers[-1].out_features)
            for new, before, (entering, leaving) in zip(new_layers, old_layers, pairwise([indices, *rows])):
                new.weight[leaving] = 0.0
                new.weight[leaving.unsqueeze(1), entering] = before.weight
                new.bias[leaving] = before.bias
    for normalizer, other, indices in zip(networks.normalizers, old.normalizers, inputs):
        assert isinstance(normalizer, RunningNormalizer) and isinstance(other, RunningNormalizer)
        normalizer.inherit(other, indices)
    networks.deviation.load_state_dict(old.deviation.state_dict())


def _check_fits(name: str, config: NetworkConfig, old: NetworkConfig, where: str) -> None:
    """Raise `ConfigError` if the policy's layers do not fit into this run's."""
    theirs, ours = list(getattr(old, name)), list(getattr(config, name))
    if len(theirs) != len(ours) or any(n < o for n, o in zip(ours, theirs)):
        raise ConfigError(
            f"{where}: the policy's network has {name}={theirs}, which does not fit into this run's {name}={ours}; "
            f"network.{name} needs as many layers, each as large or larger"
        )


def _layers(network: nn.Module) -> list[nn.Linear]:
    return [module for module in network.modules() if isinstance(module, nn.Linear)]


def _units(size: int, old: int, symmetric: bool) -> Tensor:
    """Return the indices of the old hidden units among the new ones, ``[old]``.

    In a symmetric network the second half of the units mirrors the first half, so each half grows by itself.
    """
    units = torch.arange(old)
    return torch.where(units < old // 2, units, units - old // 2 + size // 2) if symmetric else units
