"""Settings of older versions: what they are called today, and what they were before they were settings.

A saved run or policy card says which format its settings have (none: format 1). `upgrade` brings them to today's
format. A setting that did not exist then gets the value that the code had fixed at that time, never today's default.
"""

from __future__ import annotations

import copy
from typing import Any

from skatemount.envs.config.boards import RANGES
from skatemount.runs.shipped import ALIASES
from skatemount.utils.errors import ConfigError

FORMAT = 10

RENAMED: dict[str, str] = {
    "algorithm.clip": "algorithm.clip_epsilon",
    "algorithm.final_kl": "algorithm.final_target_kl",
    "algorithm.horizon": "algorithm.discount_horizon",
    "algorithm.settle": "algorithm.kl_anneal_fraction",
    "algorithm.trace": "algorithm.gae_horizon",
    "algorithm.value_coeff": "algorithm.critic_coeff",
    "collector.enough": "collector.max_mounted_time",
    "collector.steps": "collector.steps_per_env",
    "curriculum.free_after": "curriculum.free_board_after",
    "curriculum.harvest": "curriculum.stuck_start_fraction",
    "curriculum.least": "curriculum.min_episodes",
    "curriculum.lowest": "curriculum.min_height",
    "curriculum.memory": "curriculum.window",
    "curriculum.own": "curriculum.stage_range_fraction",
    "curriculum.own_beyond": "curriculum.stage_range_from",
    "curriculum.replay": "curriculum.replay_fraction",
    "curriculum.solved": "curriculum.solved_rate",
    "curriculum.steady": "curriculum.success_threshold",
    "grow": "init_from_expand",
    "handover": "switch_distance",
    "logger.csv": "logger.jsonl",
}
"""Names of format 1 and what they became in format 2."""

ADDED: dict[str, Any] = {
    "algorithm.compile": False,
    "algorithm.final_target_kl": None,
    "algorithm.kl_anneal_fraction": 0.2,
    "curriculum.stage_range_fraction": 0.0,
    "curriculum.stage_range_from": None,
    "init_from_expand": False,
    "observation.history_length": 1,
    "physics.device": "auto",
    "physics.max_constraints": 160,
    "physics.max_contacts": 48,
    "physics.tolerance": 1e-8,
}
"""Settings that saved files of format 1 may lack, with the value that they had when they were not settings yet."""

ADDED_LATER: dict[str, Any] = {
    "algorithm.kind": "ppo",
    "algorithm.params": {},
    "algorithm.teacher": None,
    "algorithm.teacher_coeff": 1.0,
    "algorithm.teacher_frames": 10_000_000,
    "board.rolling_resistance": 0.0,
    "boards": {
        **dict.fromkeys(RANGES),
        "count": 0,
        "seed": None,
        "fixed": [],
    },
    "callbacks": [],
    "command.board_point": "deck",
    "command.curvature": [-0.9, 0.9],
    "command.ride_after": 0.0,
    "command.speed": [0.3, 1.5],
    "distributed": {"timeout": 60.0, "check_every": 10},
    "init_from_other_robot": False,
    "logger.dump_diverged": 0,
    "logger.loggers": [],
    "network.kind": "mlp",
    "network.params": {},
    "physics.foot_impedance": [0.9, 0.95],
    "plugins": [],
    "randomization.torque_limit": [1.0, 1.0],
    "sensing": {
        "target_delay": [0.0, 0.0],
        "latency": [0, 0],
        "board_age": [0, 0],
        "board_seen": 1.0,
        "board_pos_bias": 0.0,
        "board_rot_bias": 0.0,
        "board_pos_jitter": 0.0,
        "board_rot_jitter": 0.0,
        "encoder_offset": 0.0,
        "joint_vel_noise": 0.0,
        "gyro_noise": 0.0,
        "gravity_noise": 0.0,
        "term_noise": True,
    },
    "start.board_lean": [0.0, 0.0],
    "start.drive": False,
    "start.either_way": True,
    "start.move_with_board": False,
    "start.truck_angle": None,
}
"""The same for files of formats 1 to 9."""

RENAMED_VALUES: dict[str, dict[str, str]] = {"robot.variant": {"unitree": "a1", "isaac": "a1_isaac"}}
"""Values of formats 1 to 3 and what they became in format 4, by setting."""

REMOVED = ("bench", "checkpoint", "episode", "episodes", "json", "output", "pipeline", "suite", "switch_distance")
"""Settings of other programs, which files of format 1 hold as well."""


def upgrade(values: dict[str, Any]) -> dict[str, Any]:
    """Return saved settings under today's names, with the settings that did not exist when they were saved.

    Args:
        values: Nested settings as they were saved, with their ``format``; left as they are.

    Raises:
        ConfigError: The format is none, or newer than this version's.
    """
    values = copy.deepcopy(values)
    saved = values.pop("format", 1)
    if type(saved) is not int or saved < 1:
        raise ConfigError(f"format={saved!r} must be a whole number from 1 to {FORMAT}")
    if saved > FORMAT:
        raise ConfigError(f"format={saved} is newer than {FORMAT}, the newest that this version reads")
    if saved < 2:
        _rename(values)
        _add(values, ADDED)
    if saved < 4:
        _rename_values(values)
    if saved < FORMAT:
        _add(values, ADDED_LATER)
        for link in _group(values, ["curriculum", "stages"]).values():
            if isinstance(link, dict):
                link.setdefault("settings", [])
    return values


def rename_override(override: str) -> str:
    """Return a command line's override with the names of today, of the setting and of its values."""
    prefix = override[: len(override) - len(override.lstrip("+~"))]
    key, equals, value = override[len(prefix) :].partition("=")
    key = RENAMED.get(key, key)
    if key in RENAMED_VALUES:
        value = ",".join(RENAMED_VALUES[key].get(each.strip(), each) for each in value.split(","))
    return f"{prefix}{key}{equals}{value}"


def renaming(override: str) -> str | None:
    """Return in words what of a command line's override has another name today; None if nothing has."""
    today = rename_override(override)
    if today == override:
        return None
    (old, _, was), (new, _, value) = (each.lstrip("+~").partition("=") for each in (override, today))
    return f"{old} is called {new} now" if old != new else f"{old}={was} is called {new}={value} now"


def _rename_values(values: dict[str, Any]) -> None:
    """Bring values of formats 1 to 3 under today's names, in place."""
    for key, names in RENAMED_VALUES.items():
        *groups, name = key.split(".")
        holder = _group(values, groups)
        if isinstance(value := holder.get(name), str):
            holder[name] = names.get(value, value)


def _rename(values: dict[str, Any]) -> None:
    """Bring settings of format 1 under today's names, in place."""
    for old, new in RENAMED.items():
        *groups, name = old.split(".")
        holder = _group(values, groups)
        if name in holder:
            holder[new.split(".")[-1]] = holder.pop(name)
    for name in REMOVED:
        values.pop(name, None)
    for holder in (values, _group(values, ["stage"])):
        if isinstance(spec := holder.get("init_from"), str):
            prefix, colon, name = spec.partition(":")
            holder["init_from"] = f"{prefix}{colon}{ALIASES.get(name, name)}"


def _add(values: dict[str, Any], added: dict[str, Any]) -> None:
    """Give the settings that are missing the value of their time, in place."""
    for key, value in added.items():
        *groups, name = key.split(".")
        _group(values, groups).setdefault(name, copy.deepcopy(value))


def _group(values: dict[str, Any], names: list[str]) -> dict[str, Any]:
    for name in names:
        found = values.setdefault(name, {})
        if not isinstance(found, dict):
            # Not settings at all: whoever reads them says so.
            return {}
        values = found
    return values
