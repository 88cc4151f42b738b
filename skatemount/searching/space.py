"""Space of a search: its ranges checked against the settings of a training, before anything is trained."""

from __future__ import annotations

import copy
import typing
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from skatemount.config import TrainConfig, compose_program
from skatemount.config.compose import checked, composed_values
from skatemount.config.files import groups
from skatemount.config.keys import in_words, is_known, keys, unknown
from skatemount.config.overrides import prepare
from skatemount.config.search import Dimension
from skatemount.runs.sweep import SEARCH, key_of
from skatemount.utils.errors import ConfigError

if TYPE_CHECKING:
    from optuna.trial import Trial

TRAIN = "train"

Value = float | int | str

_NOT_SEARCHED = {
    "logger": "the output of a run does not make it better",
    "plugins": "give the modules as a setting",
    "resume": "every trial is a run of its own",
    "stage": "success in different stages cannot be compared",
    "suite": "success in different suites cannot be compared",
    "task": "success in different tasks cannot be compared",
    "total_frames": "more steps are nearly always better; give one number",
}
"""Settings and groups that cannot be searched, and why."""


def of_training(overrides: Sequence[str]) -> list[str]:
    """Return the overrides of a search that are settings of its trainings."""
    return [each for each in overrides if key_of(each).partition(".")[0] != SEARCH]


def check_space(dimensions: Sequence[Dimension], overrides: Sequence[str]) -> None:
    """Check that the ends of every range, and every choice, can be used in the training that is asked for.

    Values that cannot be used together show only in their trial.

    Args:
        dimensions: The space.
        overrides: Settings of the training.

    Raises:
        ConfigError: A setting does not exist or cannot be searched, or a value of its range cannot be used.
    """
    given = {key_of(each): each for each in overrides}
    for each in dimensions:
        _check_key(each)
        if each.key in given:
            raise ConfigError(f"{each.where}: {given[each.key]} is given as well; leave out one of the two")
        inner = next((other for other in dimensions if other.key.startswith(f"{each.key}.")), None)
        if inner is not None:
            raise ConfigError(f"{each.where}: search.space.{inner.key} is a part of it; leave out one of the two")
    values = composed_values(TRAIN, overrides)
    for each in dimensions:
        for text in each.choices or (_text(each.low), _text(each.high)):
            try:
                _check_value(each, text, values, overrides)
            except ConfigError as error:
                raise ConfigError(f"{each.where}: {error}") from error


def suggest(trial: Trial, dimensions: Sequence[Dimension]) -> dict[str, Value]:
    """Return the values of a trial, which Optuna chooses where it has not yet.

    Args:
        trial: The trial.
        dimensions: The space.
    """
    found: dict[str, Value] = {}
    for each in dimensions:
        if each.kind == "choice":
            found[each.key] = str(trial.suggest_categorical(each.key, each.choices))
        elif each.kind == "int":
            step = 1 if each.step is None else int(each.step)
            found[each.key] = trial.suggest_int(each.key, int(each.low), int(each.high), step=step, log=each.log)
        else:
            found[each.key] = trial.suggest_float(each.key, each.low, each.high, step=each.step, log=each.log)
    return found


def overrides_of(params: Mapping[str, Value]) -> list[str]:
    """Return the values of a trial as overrides in Hydra's form.

    Args:
        params: Values by the setting's key.
    """
    return prepare([f"{key}={_text(value)}" for key, value in params.items()], TRAIN)


def _text(value: Value) -> str:
    # repr gives back the same float.
    return value if isinstance(value, str) else repr(value)


def _check_key(dimension: Dimension) -> None:
    key = dimension.key
    top = key.partition(".")[0]
    is_group = key in groups(TRAIN)
    if top in (SEARCH, "hydra", "launcher") or not is_group and not is_known(TrainConfig, key):
        raise ConfigError(unknown(TRAIN, key, dimension.where) if top != SEARCH else f"{dimension.where}: {_OWN}")
    for refused in (key, top):
        if refused in _NOT_SEARCHED:
            raise ConfigError(f"{dimension.where}: {refused} cannot be searched; {_NOT_SEARCHED[refused]}")
    if dimension.kind == "choice":
        return
    hint = keys(TrainConfig).get(key)
    if is_group:
        raise ConfigError(f"{dimension.where}: {key} is a group; write choice(a,b)")
    kinds = {hint, *typing.get_args(hint)}
    if int in kinds and float not in kinds and dimension.kind == "float":
        form = "logint" if dimension.log else "int"
        raise ConfigError(f"{dimension.where}: {key} takes whole numbers; write {form}(low,high)")
    if hint is not None and not {int, float, typing.Any} & kinds or typing.get_origin(hint) is list:
        raise ConfigError(f"{dimension.where}: {key} must be {in_words(hint)}; write choice(a,b)")


_OWN = "a search cannot search its own settings"


def _check_value(dimension: Dimension, text: str, values: dict[str, Any], overrides: Sequence[str]) -> None:
    """Raise `ConfigError` if a training cannot use a value of a range."""
    keys_above = dimension.key.split(".")
    if dimension.kind == "choice":
        compose_program(TRAIN, [*overrides, *overrides_of({dimension.key: text})])
        return
    # Composing once more for each end would take seconds.
    changed = copy.deepcopy(values)
    place = changed
    for key in keys_above[:-1]:
        place = place.setdefault(key, {})
        if not isinstance(place, dict):
            raise ConfigError(f"there is no setting {dimension.key}")
    place[keys_above[-1]] = int(text) if dimension.kind == "int" else float(text)
    checked(changed, TRAIN)
