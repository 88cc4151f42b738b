"""Settings composed from YAML by Hydra, and checked."""

from __future__ import annotations

import copy
import functools
import re
import typing
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import hydra
from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import MissingMandatoryValue, OmegaConfBaseException

from skatemount.config.files import check_choice, config_dirs, user_config_dir, using_config_dir
from skatemount.config.files import config_dir as package_config_dir
from skatemount.config.keys import in_words, is_known, keys, unknown
from skatemount.config.messages import one_line
from skatemount.config.overrides import prepare, refuse_text
from skatemount.config.own_files import check_own_files, with_path, with_place
from skatemount.config.plugins import import_classes, import_plugins, require_classes, require_plugins
from skatemount.config.programs import PROGRAMS
from skatemount.config.schema import TrainConfig
from skatemount.config.sizes import check_sizes
from skatemount.config.versions import FORMAT, upgrade
from skatemount.envs.config.task import TaskConfig
from skatemount.utils.errors import ConfigError, brief

_WRITTEN_WITH_EXPONENT = re.compile(r"[+-]?\d+(\.\d*)?[eE]\+?\d+")


def compose(
    stage: str | None = None, overrides: Sequence[str] = (), config_dir: Path | str | None = None
) -> TrainConfig:
    """Compose the settings of a training from Python; works inside a running Hydra application, too.

    Args:
        stage: Name of a stage.
        overrides: Further settings as on the command line, ``["board=longboard", "reward.mounted.weight=5"]``.
        config_dir: Folder of the user's own stages, boards and other groups, for this call; `set_user_config_dir` sets
            it for the whole process, which evaluations and chains need.

    Raises:
        ConfigError: An unknown stage, setting or value, or overrides that are a text and no list.
    """
    refuse_text(overrides)
    with using_config_dir(config_dir):
        if stage is not None:
            check_choice("stage", stage)
            overrides = [f"stage={stage}", *overrides]
        config = compose_program("train", overrides)
    assert isinstance(config, TrainConfig)
    return config


def compose_task(stage: str | None = None, overrides: Sequence[str] = ()) -> TaskConfig:
    """Compose the settings of a task; the arguments are those of `compose`."""
    return compose(stage, overrides)


def compose_program(program: str, overrides: Sequence[str]) -> TaskConfig:
    """Compose the settings of one of the programs.

    Args:
        program: A key of `PROGRAMS`.
        overrides: Settings as on the command line.

    Raises:
        ConfigError: An unknown setting or value.
    """
    return checked(composed_values(program, overrides), program)


def composed_values(program: str, overrides: Sequence[str]) -> dict[str, Any]:
    """Compose the settings of one of the programs as plain values, without checking them.

    Args:
        program: A key of `PROGRAMS`.
        overrides: Settings as on the command line.

    Raises:
        ConfigError: An unknown setting or choice.
    """
    prepared = prepare(overrides, program)
    check_own_files(prepared)
    values = _composed(program, tuple([*_search_path(), *prepared]), _fingerprint())
    return copy.deepcopy(values)


@functools.lru_cache(maxsize=64)
def _composed(program: str, overrides: tuple[str, ...], fingerprint: tuple[int, int]) -> dict[str, Any]:
    """Return composed values; evaluations and chains ask for the same ones again, and Hydra takes a third of a second.

    Args:
        program: A key of `PROGRAMS`.
        overrides: In Hydra's form.
        fingerprint: State of the YAML files.
    """
    # Hydra knows one application at a time: a running one steps aside.
    running, GlobalHydra.instance().hydra = GlobalHydra.instance().hydra, None
    try:
        with hydra.initialize_config_dir(str(package_config_dir().absolute()), version_base="1.3"):
            return plain(hydra.compose(program, list(overrides)))
    except ConfigError:
        raise
    except Exception as error:
        raise ConfigError(with_path(one_line(error))) from error
    finally:
        GlobalHydra.instance().hydra = running


def _search_path() -> list[str]:
    """Return the override that makes Hydra look into the user's folder, if there is one."""
    folder = user_config_dir()
    if folder is None:
        return []
    escaped = str(folder).replace("\\", "\\\\").replace("'", "\\'")
    return [f"hydra.searchpath=['file://{escaped}']"]


def _fingerprint() -> tuple[int, int]:
    """Return a number of files and a time that change when a YAML file does."""
    times = [path.stat().st_mtime_ns for folder in config_dirs() for path in folder.rglob("*.yaml")]
    return len(times), max(times)


def plain(composed: DictConfig) -> dict[str, Any]:
    """Return composed settings as plain values, interpolations resolved.

    Raises:
        ConfigError: An interpolation that leads nowhere.
    """
    try:
        values = OmegaConf.to_container(composed, resolve=True)
    except OmegaConfBaseException as error:
        raise ConfigError(one_line(error)) from error
    assert isinstance(values, dict)
    return values  # type: ignore[return-value]


@functools.cache
def _structured(program: str) -> DictConfig:
    """Return the schema of a program; a merge copies it, so one is enough for all compositions."""
    return OmegaConf.structured(PROGRAMS[program])


def checked(
    values: dict[str, Any], program: str, untrusted: str | None = None, training: bool = True, sizes: bool = True
) -> TaskConfig:
    """Return plain values as the dataclasses of a program, validated.

    Args:
        values: Nested settings; whole numbers that YAML reads as text or floats are changed in place.
        program: A key of `PROGRAMS`.
        untrusted: Name of settings from elsewhere, whose plugins and classes must be imported already; None imports
            them.
        training: The classes that only a training needs are needed.
        sizes: Refuse what this machine has not the memory or time for.

    Raises:
        ConfigError: A key that does not exist, one that is missing, or a value that cannot be used.
    """
    try:
        return _checked(values, program, untrusted, training, sizes)
    except ConfigError as error:
        # Only saved settings may be of another machine's size; they come from no file of the user's.
        placed = with_place(error, values) if sizes else error
        if placed is error:
            raise
        raise placed from error


def _checked(values: dict[str, Any], program: str, untrusted: str | None, training: bool, sizes: bool) -> TaskConfig:
    schema = PROGRAMS[program]
    _check_keys(values, schema, program)
    try:
        result = OmegaConf.to_object(OmegaConf.merge(_structured(program), values))
    except ConfigError:
        raise
    except MissingMandatoryValue as error:
        raise ConfigError(f"{error.full_key} is missing: give {error.full_key}=<value>") from error
    except OmegaConfBaseException as error:
        raise ConfigError(_wrong_type(error, values, schema)) from error
    assert isinstance(result, TaskConfig)
    # Before anything that they register is checked. Without plugins, this imports nothing.
    if untrusted is None:
        import_plugins(result.plugins)
        import_classes(result, training)
    else:
        require_plugins(result.plugins, untrusted)
        require_classes(result, untrusted, training)
    result.validate()
    if sizes:
        check_sizes(result)
    result.validate_terms()
    return result


def _check_keys(values: dict[str, Any], schema: type[TaskConfig], program: str, prefix: str = "") -> None:
    known = keys(schema)
    groups = {f"{each.rpartition('.')[0]}." for each in known}
    for name, value in values.items():
        key = f"{prefix}{name}"
        if not is_known(schema, key):
            raise ConfigError(unknown(program, key, key if isinstance(value, dict) else f"{key}={value}"))
        is_group = typing.get_origin(known.get(key)) is dict or f"{key}." in groups
        if is_group and not isinstance(value, dict) and type(None) not in typing.get_args(known[key]):
            raise ConfigError(f"{key}={brief(value)} must be a group of settings")
        if isinstance(value, dict) and any(each.startswith(f"{key}.") for each in known):
            _check_keys(value, schema, program, f"{key}.")
        elif known.get(key) is int and (isinstance(value, float) and value.is_integer() or _is_exponent(value)):
            # YAML reads 1e6 as text, and 1.0e+6 as a float.
            values[name] = int(float(value))


def _is_exponent(value: Any) -> bool:
    whole = isinstance(value, str) and len(value) < 30 and _WRITTEN_WITH_EXPONENT.fullmatch(value)
    return bool(whole) and float(value).is_integer()


def _wrong_type(error: OmegaConfBaseException, values: dict[str, Any], schema: type[TaskConfig]) -> str:
    """Return an error that names the setting, its value and the values that it takes."""
    key = re.sub(r"\[.*", "", error.full_key or "")
    hint = keys(schema).get(key)
    if hint is None:
        return one_line(error)
    value: Any = values
    for part in key.split("."):
        value = value.get(part) if isinstance(value, dict) else None
    text = f"[{', '.join(map(str, value))}]" if isinstance(value, list) else "null" if value is None else value
    return f"{key}={text} must be {in_words(hint)}"


def from_dict(
    values: dict[str, Any], own: bool = False, where: str = "saved settings", training: bool = False
) -> TrainConfig:
    """Return the settings that a run or a policy card has saved.

    Args:
        values: Result of `to_dict`, of this version or an older one; see `skatemount.config.versions`.
        own: Import their plugins and classes. Only for a run of one's own: settings from elsewhere must not run code.
        where: Name of the settings, for messages.
        training: The classes that only a training needs are needed, because the run is resumed.

    Raises:
        ConfigError: They are damaged, of a newer version, or need plugins that are not imported.
    """
    try:
        _refuse_interpolations(values, "")
        config = checked(upgrade(values), "train", None if own else "not a run of your own", training, sizes=False)
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}") from error
    assert isinstance(config, TrainConfig)
    return config


def _refuse_interpolations(value: Any, key: str) -> None:
    """Raise `ConfigError` for an interpolation: saved settings are values, and must not read the environment."""
    if isinstance(value, dict):
        for name, part in value.items():
            _refuse_interpolations(part, f"{key}.{name}" if key else str(name))
    elif isinstance(value, list):
        for part in value:
            _refuse_interpolations(part, key)
    elif isinstance(value, str) and "${" in value:
        raise ConfigError(f"{key}={brief(value)} must be a value; saved settings have no interpolations")


def to_dict(config: TrainConfig) -> dict[str, Any]:
    """Return settings as plain values, with the format that they are in."""
    values = OmegaConf.to_container(OmegaConf.structured(config))
    assert isinstance(values, dict)
    return {"format": FORMAT, **values}
