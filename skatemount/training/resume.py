"""Settings of a run that resumes."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

from skatemount import config as configuration
from skatemount.config import TrainConfig
from skatemount.runs.find import find_checkpoint, is_own_run
from skatemount.runs.folder import RunFolder
from skatemount.utils.errors import ConfigError


def resume_config(config: TrainConfig, overrides: list[str]) -> TrainConfig:
    """Return the settings that a resumed run saved, with the changes of the command line.

    Args:
        config: As composed from the command line; returned as it is unless ``resume`` is set.
        overrides: The overrides of the command line.

    Raises:
        ConfigError: There is no such run, or see `apply_resume_overrides`.
    """
    if config.resume is None:
        return config
    folder = find_checkpoint(config.resume, Path(config.logger.root), setting="resume")
    run = RunFolder.open(folder, setting="resume")
    own = is_own_run(folder, config.logger.root)
    saved = configuration.from_dict(run.config, own=own, where=f"resume={config.resume}: saved settings", training=True)
    apply_resume_overrides(saved, config, overrides)
    # A run stands for its latest checkpoint, which is looked for once no other process can add one.
    named = Path(config.resume)
    saved.resume = str(folder if named.name in ("best", folder.name) else run.path)
    return saved


_DECIDED_BY = {"stage": "stage.name", "task": "success"}
"""Settings that tell which file of a group was chosen, where the file sets more than the group."""

_MANY = ("experiment",)
"""Groups whose files leave no trace of their names."""


def apply_resume_overrides(saved: TrainConfig, config: TrainConfig, overrides: list[str]) -> None:
    """Apply those overrides to a run's saved settings that may change in the middle of a run.

    Others are accepted if the run has the same value.

    Args:
        saved: The run's settings, changed in place.
        config: As composed from the command line.
        overrides: The overrides of the command line.

    Raises:
        ConfigError: A setting that cannot be changed, or a value that contradicts a saved one.
    """
    may_change = ("total_frames", "torch_threads", "physics.threads")
    values = [configuration.to_dict(each) for each in (saved, config)]
    for override in overrides:
        key = override.lstrip("+~").partition("=")[0]
        if key in ("resume", "logger.root", "plugins"):
            # They only say where the run is, and what is imported.
            continue
        named = key in ("logger.name", "logger.experiment")
        if named or not (key in may_change or key.startswith("logger.")):
            old_value, new_value = (_value(each, _DECIDED_BY.get(key, key)) for each in values)
            if old_value == new_value and key not in _MANY:
                continue
            raise ConfigError(
                f"{override} cannot be changed with resume; {', '.join(may_change)} and logger.* (but name and "
                "experiment) can, else use init_from"
            )
        *groups, name = key.split(".")
        old, new = (functools.reduce(getattr, groups, each) for each in (saved, config))
        setattr(old, name, getattr(new, name))
    saved.validate()


def _value(values: dict[str, Any], key: str) -> Any:
    """Return the value of a setting or group among nested ones; None if there is none."""
    found: Any = values
    for part in key.replace("/", ".").split("."):
        found = found.get(part) if isinstance(found, dict) else None
    return found
