"""Estimates of the memory and time that settings ask for; what the machine cannot give is refused at once.

Only settings that a user composes are checked, not saved ones: a policy of a larger machine can be used on a small one.
"""

from __future__ import annotations

import itertools
import os

from skatemount.config.programs import EvaluateConfig, RecordConfig, ReportConfig
from skatemount.config.schema import TrainConfig
from skatemount.envs.config.task import TaskConfig
from skatemount.models.config import NetworkConfig
from skatemount.utils.errors import ConfigError
from skatemount.utils.formatting import format_count

WORLD = 264_000
"""Memory of a world on the CPU, bytes: the difference between 64 and 4096 worlds of the stage balance, by world."""

STEP = 10_000
"""Memory of a world's step in a rollout and its update, bytes: the difference between 4 and 24 steps a world."""

WEIGHT = 20
"""Memory of a weight, bytes: itself, its gradient, two moments of Adam and the copy that a checkpoint writes."""

RATE = 14_000
"""Physics steps a second of a core, learning included: that of the stage balance with 1024 worlds on two cores."""

ITERATION_HOURS = 1.0
"""Longest iteration of a training."""

EVALUATION_HOURS = 24.0
"""Longest evaluation."""

PIXELS = 10**11
"""Largest film, all pictures together; an hour at 60 pictures a second in the default size has 8e10."""


def check_sizes(config: TaskConfig, memory: int | None = None, cores: int | None = None) -> None:
    """Check that this machine can do what composed settings ask for.

    Args:
        config: The settings, each valid by itself.
        memory: Memory of the machine, bytes; asked from the system if None.
        cores: Cores that may be used; asked from the system if None.

    Raises:
        ConfigError: They need more memory or time than there is; the message says the estimate and the limit.
    """
    cores = cores or os.cpu_count() or 1
    if isinstance(config, TrainConfig):
        _check_memory(config, memory or physical_memory())
        _check_iteration(config, cores)
        for name in ("evaluate_episodes", "final_episodes"):
            _check_evaluation(f"logger.{name}", getattr(config.logger, name), config, cores)
    elif isinstance(config, EvaluateConfig):
        _check_evaluation("episodes", config.episodes, config, cores)
    elif isinstance(config, ReportConfig):
        _check_evaluation("page.episodes", config.page.episodes, config, cores)
    elif isinstance(config, RecordConfig):
        _check_evaluation("searched", config.searched, config, cores)
        # A slow motion has as many pictures a second as a film at the usual speed.
        pictures = config.episode_length / min(1.0, config.film.speed) / config.physics.control_step
        if (pixels := pictures * config.film.width * config.film.height) > PIXELS:
            raise ConfigError(
                f"episode_length={config.episode_length}: a film of {format_count(pictures)} pictures of "
                f"film.width={config.film.width} and film.height={config.film.height} has {pixels:.1e} pixels; at most "
                f"{PIXELS:.0e} are possible"
            )


def physical_memory() -> int | None:
    """Return the memory of this machine, bytes; None if the system does not tell."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return None


def _check_memory(config: TrainConfig, memory: int | None) -> None:
    worlds, steps = config.physics.num_worlds, config.collector.steps_per_env
    parts = {f"network.actor={list(config.network.actor)}": weights(config.network) * WEIGHT}
    if config.physics.engine == "cpu":
        parts[f"physics.num_worlds={worlds}"] = worlds * WORLD
        parts[f"collector.steps_per_env={steps}"] = worlds * steps * STEP
    total = sum(parts.values())
    if memory is not None and total > memory:
        largest = max(parts, key=lambda name: parts[name])
        raise ConfigError(
            f"{largest}: the training would take about {total / 1e9:.3g} GB ({worlds} worlds, {steps} steps each), and "
            f"this machine has {memory / 1e9:.3g} GB"
        )


def _check_iteration(config: TrainConfig, cores: int) -> None:
    if config.physics.engine != "cpu":
        return
    physics = config.physics
    steps = physics.num_worlds * config.collector.steps_per_env * physics.substeps
    if (hours := steps / (RATE * cores) / 3600) > ITERATION_HOURS:
        raise ConfigError(
            f"physics.substeps={physics.substeps}: an iteration of physics.num_worlds={physics.num_worlds} with "
            f"collector.steps_per_env={config.collector.steps_per_env} would take about {hours:.3g} hours on {cores} "
            f"cores; at most {ITERATION_HOURS:g} is possible"
        )


def _check_evaluation(where: str, episodes: int, config: TaskConfig, cores: int) -> None:
    if config.physics.engine != "cpu":
        return
    steps = episodes * config.episode_length / config.physics.timestep
    if (hours := steps / (RATE * cores) / 3600) > EVALUATION_HOURS:
        raise ConfigError(
            f"{where}={episodes}: episodes of episode_length={config.episode_length} s with "
            f"physics.timestep={config.physics.timestep} s would take about {hours:.3g} hours on {cores} cores; at "
            f"most {EVALUATION_HOURS:g} are possible"
        )


def weights(network: NetworkConfig) -> int:
    """Return the number of weights between the hidden layers of actor and critic."""
    return sum(a * b for sizes in (network.actor, network.critic) for a, b in itertools.pairwise(sizes))
