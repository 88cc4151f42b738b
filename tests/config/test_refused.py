"""Nonsense is refused in one line that names the setting; `refused_cases` has the inputs."""

from __future__ import annotations

import copy
import functools
from typing import Any

import pytest
from composed import one_line, stage_config
from refused_cases import (
    CHOICES,
    EDGES,
    INF,
    LAYERS,
    MAY_BE_NULL,
    NAMES,
    NAN,
    NUMBERS,
    PARAMETERS,
    RANGES,
    ROWS,
    SAVED,
    SIZES,
    SUITES,
    TABLES,
    TOGETHER,
)

from skatemount.config import TrainConfig, compose_program, from_dict, to_dict
from skatemount.config.sizes import check_sizes
from skatemount.config.suite import SuiteConfig
from skatemount.envs.config.task import TaskConfig
from skatemount.utils.errors import ConfigError


def _train() -> TrainConfig:
    return copy.deepcopy(stage_config("balance"))


def _set(config: TaskConfig, key: str, value: Any) -> None:
    part: Any = config
    *path, name = key.split(".")
    for each in path:
        part = part[each] if isinstance(part, dict) else getattr(part, each)
    setattr(part, name, value)


def _message(action: Any, *arguments: Any) -> str:
    with pytest.raises(ConfigError) as error:
        action(*arguments)
    return one_line(error)


def _numbers() -> list[tuple[str, str, Any]]:
    cases = []
    for key, (low, high) in NUMBERS.items():
        kinds = {"below": low, "above": high, "nan": NAN, "infinite": -INF, "text": "many", "null": None}
        cases += [(kind, key, value) for kind, value in kinds.items()]
    for key, (below, above) in RANGES.items():
        kinds = {
            "range below": below,
            "range above": above,
            "range reversed": below[::-1],
            "range of nan": [NAN, NAN],
            "range of three": [*below, 1.0],
        }
        cases += [(kind, key, value) for kind, value in kinds.items()]
        if key not in MAY_BE_NULL:
            cases.append(("null", key, None))
    return cases


@pytest.mark.parametrize("kind", sorted({kind for kind, _, _ in _numbers()}))
def test_numbers(kind: str) -> None:
    for case, key, value in _numbers():
        if case == kind:
            config = _train()
            _set(config, key, value)
            text = _message(config.validate)
            # A contradiction may name its other setting first.
            assert key in text or key.split(".")[-1] in text, text
            assert str(value) in text or kind == "null", text


LISTED = {
    "choices": CHOICES,
    "empty tables": TABLES,
    "rows of tables": ROWS,
    "layers": LAYERS,
    "edges of bins": EDGES,
    "names": NAMES,
}


def _validate(config: TrainConfig) -> None:
    config.validate()
    # Names of tasks and terms need torch, so they are checked apart.
    config.validate_terms()


@pytest.mark.parametrize("kind", LISTED)
def test_single_settings(kind: str) -> None:
    for key, value, expected in LISTED[kind]:
        config = _train()
        _set(config, key, value)
        text = _message(lambda config=config: _validate(config))
        assert key in text and expected in text, text


def test_parameters_of_terms() -> None:
    for table, name, value, expected in PARAMETERS:
        config = _train()
        term, parameter = name.split(".")
        rows = functools.reduce(getattr, table.split("."), config)
        rows[term].params = {**rows[term].params, parameter: value}
        text = _message(config.validate_terms)
        assert f"{table}.{term}.params.{parameter}" in text and expected in text, text


def test_settings_that_contradict_each_other() -> None:
    for changes, expected in TOGETHER:
        config = _train()
        for key, value in changes.items():
            _set(config, key, value)
        text = _message(config.validate)
        assert expected in text, text


def test_a_training_that_the_machine_cannot_do() -> None:
    for changes, expected in SIZES:
        config = _train()
        for key, value in changes.items():
            _set(config, key, value)
        config.validate()
        text = _message(functools.partial(check_sizes, memory=2 * 10**9, cores=2), config)
        assert expected in text, text


def test_suites() -> None:
    for changes, expected in SUITES:
        values = {"name": "mine", "stage": "mount"} | changes
        assert expected in _message(SuiteConfig(**values).validate)


def test_saved_settings() -> None:
    saved = to_dict(_train())
    for changes, expected in SAVED:
        values = copy.deepcopy(saved)
        for key, value in changes.items():
            values[key] = {**values[key], **value} if isinstance(value, dict) and value else value
        text = _message(from_dict, values)
        assert expected in text and text.startswith("saved settings: "), text


PROGRAMS: list[tuple[str, str, str]] = [
    ("evaluate", "episodes=0", "episodes=0"),
    ("evaluate", "episodes=1e12", "episodes=1000000000000"),
    ("evaluate", "episodes=999999 episode_length=3600", "episodes=999999: episodes of episode_length=3600"),
    ("evaluate", "switch_distance=-1", "switch_distance=-1"),
    ("evaluate", "seed=-1", "seed=-1"),
    ("record", "film.width=641", "an even number"),
    ("record", "film.width=100000", "from 160 to 3840"),
    ("record", "film.height=0", "from 120 to 2160"),
    ("record", "film.speed=0", "0.5 plays at half speed"),
    ("record", "film.camera=left", "follow, side, top, fixed"),
    ("record", "episode=-1", "episode=-1"),
    ("record", "episode_length=3600 film.width=3840 film.height=2160", "pixels"),
    ("bench", "bench.rounds=0", "bench.rounds=0"),
    ("bench", "bench.seconds=inf", "bench.seconds=inf"),
    ("bench", "bench.worlds=[0]", "bench.worlds=[0]"),
    ("bench", "bench.threads=[-1]", "bench.threads=[-1]"),
    ("train", "+stage=balance total_frame=5", "total_frame"),
    ("train", "+stage=balance physics.num_worlds=many", "physics.num_worlds=many must be a whole number"),
    ("train", "+stage=balance seed=${nosuch}", "nosuch"),
]


def test_the_programs() -> None:
    for program, words, expected in PROGRAMS:
        text = _message(compose_program, program, words.split())
        assert expected in text, text


def test_there_are_enough_of_them() -> None:
    counts = {kind: sum(case == kind for case, _, _ in _numbers()) for kind, _, _ in _numbers()}
    counts |= {kind: len(cases) for kind, cases in LISTED.items()}
    for cases in (PARAMETERS, TOGETHER, SIZES, SUITES, SAVED, PROGRAMS):
        counts[str(len(counts))] = len(cases)  # type: ignore[arg-type]
    assert sum(counts.values()) >= 400 and all(counts.values())
