"""A trial of networks of one's own: actor and critic are called once, before anything is trained."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from skatemount.models.symmetry import Reflection
from skatemount.utils.errors import ConfigError, reason

if TYPE_CHECKING:
    from skatemount.models.base import Networks

WORLDS, STEPS = 5, 2
"""Number of worlds and of control steps of a trial."""


@contextmanager
def unchanged(networks: Networks) -> Iterator[None]:
    """Restore weights, buffers and torch's random state after a ``with`` block, in which no gradient is computed."""
    tensors = [*networks.parameters(), *networks.buffers()]
    before = [each.detach().clone() for each in tensors]
    devices = {each.device for each in tensors if each.device.type == "cuda"}
    with torch.no_grad(), torch.random.fork_rng(list(devices)):
        try:
            yield
        finally:
            for each, value in zip(tensors, before):
                each.copy_(value)


def try_networks(networks: Networks, reflections: tuple[Reflection, Reflection, Reflection] | None) -> None:
    """Call actor and critic, and compare them in a mirrored state if the networks must be symmetric.

    Args:
        networks: The networks.
        reflections: Reflections of ``observation``, ``privileged`` and ``action``; None if nothing must be symmetric.

    Raises:
        ConfigError: A network fails, lacks an output, gives one of the wrong shape, or is not symmetric.
    """
    with unchanged(networks):
        given = random_observations(networks)
        run(networks, given)
        if reflections is None:
            return
        # New networks may be symmetric only because a layer begins with zeros.
        for parameter in networks.parameters():
            parameter.add_(0.1 * torch.randn_like(parameter))
        of_action = reflections[2]
        mirrored = [{key: image(each[key]) for key, image in zip(each, reflections)} for each in given]
        for seen, image in zip(run(networks, given), run(networks, mirrored)):
            same = (
                _close(of_action(seen["loc"]), image["loc"])
                and _close(of_action(seen["scale"]).abs(), image["scale"])
                and _close(seen["state_value"], image["state_value"])
            )
            if not same:
                where = f"network.symmetric=true: {title(networks)} (network.kind={networks.config.kind})"
                raise ConfigError(
                    f"{where} does not give the mirrored action and the same value for a mirrored observation; use "
                    "network.symmetric=false, or build its layers from `reflections`, as "
                    "skatemount.models.actor_critic does"
                )


def title(networks: Networks) -> str:
    """Return class and module of networks, for messages."""
    return f"{type(networks).__name__} of {type(networks).__module__}"


def random_observations(networks: Networks) -> list[dict[str, Tensor]]:
    """Draw ``observation`` and ``privileged``, ``[WORLDS, size]``, for each of `STEPS` steps."""
    here = next(networks.parameters()).device
    observation, privileged, _ = networks.sizes
    sizes = {"observation": observation, "privileged": privileged}
    return [{key: torch.randn(WORLDS, size, device=here) for key, size in sizes.items()} for _ in range(STEPS)]


def run(networks: Networks, given: list[dict[str, Tensor]]) -> list[TensorDictBase]:
    """Run actor and critic step by step, as the collector does.

    Args:
        networks: The networks.
        given: Observations of each step.

    Returns:
        For each step everything that the networks read and wrote.

    Raises:
        ConfigError: A network fails, lacks an output, or gives one of the wrong shape.
    """
    where, actions = f"network.kind={networks.config.kind}", networks.sizes[2]
    for name in ("actor_keys", "critic_keys"):
        if unknown := [key for key in getattr(networks, name) if key not in given[0]]:
            raise ConfigError(
                f"{where}: {name} of {title(networks)} has {unknown[0]!r}; they can be observation and privileged"
            )
    steps: list[TensorDictBase] = []
    memory: dict[str, Tensor] = {}
    for i, observed in enumerate(given):
        state = TensorDict(dict(observed), [WORLDS])
        if networks.recurrent:
            state["is_init"] = torch.full((WORLDS, 1), i == 0, device=state["observation"].device)
            state.update(memory)
        acted = _call(networks, "actor", networks.actor, state)
        shapes = {"loc": (actions,), "scale": (actions,), "action": (actions,), "action_log_prob": ()}
        for key, shape in shapes.items():
            _check(where, networks, "actor", acted, key, shape)
        for key in networks.state_keys:
            _check(where, networks, "actor", acted, ("next", key), None)
        memory = {key: acted["next", key] for key in networks.state_keys}
        valued = _call(networks, "critic", networks.critic, TensorDict(dict(observed), [WORLDS]))
        _check(where, networks, "critic", valued, "state_value", (1,))
        steps.append(acted.set("state_value", valued["state_value"]))
    return steps


def _call(networks: Networks, name: str, network: Callable[[TensorDictBase], Any], state: TensorDict) -> TensorDictBase:
    where = f"network.kind={networks.config.kind}: {name} of {title(networks)}"
    keys = getattr(networks, f"{name}_keys")
    # An actor reads its own observations alone, as it does where it is deployed.
    unread = [key for key in ("observation", "privileged") if key not in keys]
    try:
        result = network(state.exclude(*unread))
    except Exception as error:
        raise ConfigError(f"{where} failed when tried with {WORLDS} worlds: {reason(error)}") from error
    if not isinstance(result, TensorDictBase):
        raise ConfigError(f"{where} returned {type(result).__name__}; it must return the tensordict that it got")
    return result.update(state.select(*unread))


def _check(
    where: str,
    networks: Networks,
    name: str,
    result: TensorDictBase,
    key: str | tuple[str, str],
    shape: tuple[int, ...] | None,
) -> None:
    """Check an output, ``[WORLDS, *shape]`` float32, or ``[WORLDS, ...]`` if the shape is None."""
    written = key if isinstance(key, str) else ".".join(key)
    value = result.get(key, None)
    found = "nothing"
    if isinstance(value, Tensor):
        found = f"{str(value.dtype).removeprefix('torch.')} of shape {list(value.shape)}"
        if value.is_floating_point() and (value.shape == (WORLDS, *shape) if shape is not None else value.dim() > 1):
            return
    expected = f"[{', '.join(map(str, (WORLDS, *(('...',) if shape is None else shape))))}]"
    raise ConfigError(
        f"{where}: {name} of {title(networks)} wrote {found} as {written}; it must write float32 of shape {expected} "
        f"(tried with {WORLDS} worlds)"
    )


def _close(one: Tensor, other: Tensor) -> bool:
    return bool(((one - other).abs() <= 1e-4 * (1 + one.abs().max())).all())


def example_batch(networks: Networks) -> TensorDictBase:
    """Return a batch of random observations as a collector yields it, ``[WORLDS, STEPS]``."""
    given = random_observations(networks)
    steps = []
    for acted, following in zip(run(networks, given), [*given[1:], *random_observations(networks)[:1]]):
        here = acted["observation"].device
        flag = torch.zeros(WORLDS, 1, dtype=torch.bool, device=here)
        step = acted.exclude("state_value")
        for key in networks.state_keys:
            if key not in step.keys():
                step[key] = torch.zeros_like(step["next", key])  # an episode begins without memory
        flags = {key: flag.clone() for key in ("done", "terminated", "truncated", "success")}
        step.update(flags)
        after = {**following, **flags, "reward": torch.randn(WORLDS, 1, device=here)}
        step["next"] = TensorDict(after, [WORLDS]).update(step.get("next", TensorDict({}, [WORLDS])))
        steps.append(step)
    return torch.stack(steps, 1).contiguous()
