"""The keys that settings may have, by the schema, and suggestions for those that do not exist."""

from __future__ import annotations

import dataclasses
import difflib
import types
import typing
from typing import Any

from skatemount.config.files import groups
from skatemount.config.programs import PROGRAMS
from skatemount.config.versions import RENAMED
from skatemount.envs.config.task import TaskConfig

ELSEWHERE: dict[str, str] = {
    "clip_param": "algorithm.clip_epsilon",
    "clip_range": "algorithm.clip_epsilon",
    "decimation": "physics.substeps",
    "desired_kl": "algorithm.target_kl",
    "device": "physics.device",
    "ent_coef": "algorithm.entropy_coeff",
    "entropy_coef": "algorithm.entropy_coeff",
    "experiment_name": "logger.experiment",
    "gae_lambda": "algorithm.gae_horizon",
    "gamma": "algorithm.discount_horizon",
    "init_noise_std": "network.init_std",
    "lam": "algorithm.gae_horizon",
    "lr": "algorithm.learning_rate",
    "load_run": "resume",
    "max_iterations": "total_frames",
    "n_envs": "physics.num_worlds",
    "n_epochs": "algorithm.epochs",
    "n_steps": "collector.steps_per_env",
    "num_envs": "physics.num_worlds",
    "num_iterations": "total_frames",
    "num_learning_epochs": "algorithm.epochs",
    "num_mini_batches": "algorithm.minibatches",
    "num_steps_per_env": "collector.steps_per_env",
    "run_name": "logger.name",
    "save_interval": "logger.checkpoint_every",
    "total_timesteps": "total_frames",
    "value_loss_coef": "algorithm.critic_coeff",
    "vf_coef": "algorithm.critic_coeff",
}
"""Words of other frameworks (rsl_rl, Isaac Lab, Stable-Baselines3) and the settings that come nearest."""

INSTEAD = {
    ("train", "checkpoint"): "a training starts from init_from=<policy>, or goes on with resume=<run>",
    ("play", "episode"): "start.* and the page's sliders choose how an episode starts",
    ("evaluate", "episode"): "episodes=<number> says how many to evaluate",
    ("search", "launcher"): "a search has no launcher; start the command once more for another process",
}
"""Hints for settings of one program that are given to another."""


_KEYS: dict[type, dict[str, Any]] = {}


def keys(schema: type) -> dict[str, Any]:
    """Return every dotted key of a schema, groups included, with its type."""
    if schema in _KEYS:
        return _KEYS[schema]
    found = _KEYS[schema] = {}
    for name, hint in typing.get_type_hints(schema).items():
        found[name] = hint
        part = _dataclass_of(hint)
        if part is not None:
            found |= {f"{name}.{key}": inner for key, inner in keys(part).items()}
    return found


def is_known(schema: type, key: str) -> bool:
    """Return whether a schema has a key; everything in its tables counts, whose rows are checked as terms."""
    return key in keys(schema) or table_of(schema, key) is not None


def table_of(schema: type, key: str) -> str | None:
    """Return the table (``reward``, ``observation.policy``, …) that a key is a row of, or part of a row, if any."""
    parts = key.split(".")
    for i in range(len(parts) - 1, 0, -1):
        name = ".".join(parts[:i])
        if typing.get_origin(keys(schema).get(name)) is dict:
            return name
    return None


def unknown(program: str, key: str, written: str) -> str:
    """Return the error for a key that a program does not have.

    Args:
        program: The program's name.
        key: The dotted key.
        written: The setting as the user wrote it.
    """
    top = key.partition(".")[0]
    others = [name for name, schema in PROGRAMS.items() if name != program and is_known(schema, key)]
    others = others or [name for name, schema in PROGRAMS.items() if name != program and top in keys(schema)]
    if others and top not in keys(PROGRAMS[program]):
        hint = INSTEAD.get((program, key))
        owners = " and ".join([*filter(None, [", ".join(others[:-1])]), others[-1]])
        text = f"{written}: not a setting of {program}, but of {owners}"
        return f"{text}; {hint}" if hint else text
    if key in groups() and (hint := INSTEAD.get((program, key))):
        return f"{written}: {hint}"
    close = suggestions(PROGRAMS[program], key)
    first, _, rest = key.partition(".")
    searched = rest.partition(".")[2]
    if program == first == "search" and is_known(PROGRAMS["train"], searched):
        close = [f"search.space.{searched}"]
    hint = f"; did you mean {' or '.join(close)}?" if close else f"; python -m skatemount.{program} --cfg job lists all"
    return f"{written}: there is no setting {key}{hint}"


def suggestions(schema: type[TaskConfig], key: str) -> list[str]:
    """Return up to three settings that a wrong key may have meant, the likeliest first."""
    last = key.rpartition(".")[2]
    for word in (key, last):
        for table in (RENAMED, ELSEWHERE):
            if word in table:
                return [table[word]]
    known = list(dict.fromkeys([*keys(schema), *groups()]))
    by_last: dict[str, list[str]] = {}
    for each in known:
        by_last.setdefault(each.rpartition(".")[2], []).append(each)
    if last in by_last:
        return by_last[last][:3]
    close = difflib.get_close_matches(key, known, n=3)
    close += [each for name in difflib.get_close_matches(last, by_last, n=2, cutoff=0.75) for each in by_last[name]]
    return list(dict.fromkeys(close))[:3]


def in_words(hint: Any) -> str:
    """Return what values a type takes, for an error message."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (types.UnionType, typing.Union):
        return " or ".join("null" if each is type(None) else in_words(each) for each in arguments)
    if origin is list:
        return {int: "a list of whole numbers such as [1, 2]", float: "a list of numbers such as [0.5, 1.0]"}.get(
            arguments[0], "a list such as [a, b]"
        )
    names = {int: "a whole number", float: "a number", bool: "true or false", str: "text"}
    return names.get(hint, "a group of settings")


def _dataclass_of(hint: Any) -> type | None:
    for each in (hint, *typing.get_args(hint)):
        if dataclasses.is_dataclass(each) and isinstance(each, type) and typing.get_origin(hint) is not dict:
            return each
    return None
