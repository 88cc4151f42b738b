"""The configuration as one validated whole: Hydra composes the YAML groups, dataclasses say what they may hold."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import hydra
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig, ListConfig, OmegaConf

from skatemount.config.files import check_stage, config_dir
from skatemount.config.messages import one_line
from skatemount.config.schema import Config
from skatemount.config.versions import rename_override, upgrade
from skatemount.envs.config.task import TaskConfig
from skatemount.utils.errors import ConfigError


def _schema() -> DictConfig:
    """The dataclasses as Hydra's schema; rows may be added to the tables of terms, which check their own names."""
    schema = OmegaConf.structured(Config)
    for table in ("reward", "termination", "observation.policy", "observation.privileged"):
        OmegaConf.set_struct(OmegaConf.select(schema, table), False)
    return schema


ConfigStore.instance().store(name="schema", node=_schema())


def to_object(config: DictConfig | ListConfig) -> Config:
    """A composed configuration as dataclasses, validated.

    Raises:
        ConfigError: A value that cannot be used.
    """
    result = OmegaConf.to_object(config)
    assert isinstance(result, Config)
    result.validate()
    return result


def compose(stage: str | None = None, overrides: Sequence[str] = ()) -> Config:
    """Compose a configuration from Python; works while a Hydra application is running, too.

    Args:
        stage: Name of a stage, or none.
        overrides: Further settings in Hydra's syntax.

    Raises:
        ConfigError: An unknown stage, setting or value.
    """
    if stage is not None:
        check_stage(stage)
        overrides = [f"+stage={stage}", *overrides]
    # Hydra knows one application at a time: a running one steps aside.
    running, GlobalHydra.instance().hydra = GlobalHydra.instance().hydra, None
    try:
        with hydra.initialize_config_dir(str(config_dir().absolute()), version_base="1.3"):
            composed = hydra.compose("config", [rename_override(each) for each in overrides])
    except Exception as error:
        raise ConfigError(one_line(error)) from error
    finally:
        GlobalHydra.instance().hydra = running
    return to_object(composed)


def compose_task(stage: str | None = None, overrides: Sequence[str] = ()) -> TaskConfig:
    """The task's part of `compose`."""
    return compose(stage, overrides)


def from_dict(values: dict[str, Any]) -> Config:
    """The configuration that a run or a card has saved.

    Raises:
        ConfigError: It does not fit this version's settings.
    """
    try:
        return to_object(OmegaConf.merge(OmegaConf.structured(Config), upgrade(values, 1)))
    except ConfigError:
        raise
    except Exception as error:
        raise ConfigError(f"saved configuration: {one_line(error)}") from error


def to_dict(config: Config) -> dict[str, Any]:
    """A configuration as plain values."""
    values = OmegaConf.to_container(OmegaConf.structured(config))
    assert isinstance(values, dict)
    return values  # type: ignore[return-value]
