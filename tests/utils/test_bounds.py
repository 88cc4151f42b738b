from __future__ import annotations

import math
from dataclasses import dataclass, field

import pytest

from skatemount.utils.bounds import Bounds, bounds_of, check_bounds, each, interval, number
from skatemount.utils.errors import ConfigError


@dataclass
class Settings:
    gain: float = field(metadata=number(0, 10, "N", above=True, why="a motor pushes"))
    threads: int = field(metadata=number(1, 8, zero="every core"))
    x: list[float] | None = field(metadata=interval(-1, 1, "m"))
    sizes: list[int] = field(metadata=each(1, 64))
    name: str


def settings(**changes: object) -> Settings:
    return Settings(**({"gain": 1.0, "threads": 0, "x": [-1.0, 1.0], "sizes": [], "name": "a"} | changes))  # type: ignore[arg-type]


@pytest.mark.parametrize("allowed", [{}, {"x": None}, {"gain": 10}, {"sizes": [1, 64]}, {"threads": 8}])
def test_what_is_within_the_bounds_passes(allowed: dict[str, object]) -> None:
    check_bounds(settings(**allowed), "part")


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"gain": 0}, "part.gain=0 must be above 0 and at most 10 N; a motor pushes"),
        ({"gain": math.nan}, "part.gain=nan must be above 0"),
        ({"gain": None}, "part.gain=null must be above 0"),
        ({"gain": True}, "part.gain=True must be above 0"),
        ({"gain": "1"}, "part.gain=1 must be above 0"),
        ({"threads": 9}, "part.threads=9 must be 0 (every core) or from 1 to 8"),
        ({"threads": -1}, "part.threads=-1 must be 0 (every core) or from 1 to 8"),
        ({"x": [0.0, 2.0]}, "part.x=[0.0, 2.0] must be [low, high], both from -1 to 1 m"),
        ({"x": [1.0, 0.0]}, "part.x=[1.0, 0.0] must be a range [low, high] with low <= high"),
        ({"x": 1.0}, "part.x=1.0 must be [low, high]"),
        ({"sizes": [1, 65]}, "part.sizes=[1, 65] must be a list of numbers, each from 1 to 64"),
        ({"sizes": [0] * 500}, "part.sizes=[0, 0, 0"),
    ],
)
def test_what_is_not_is_one_short_line(change: dict[str, object], expected: str) -> None:
    with pytest.raises(ConfigError) as error:
        check_bounds(settings(**change), "part")
    assert str(error.value).startswith(expected) and len(str(error.value)) < 400


def test_at_the_top_a_setting_has_no_group() -> None:
    with pytest.raises(ConfigError, match=r"^gain=11 "):
        check_bounds(settings(gain=11), "")


def test_the_bounds_of_a_dataclass_by_name() -> None:
    found = bounds_of(Settings)
    assert list(found) == ["gain", "threads", "x", "sizes"]
    assert found["sizes"] == Bounds(1, 64, shape="each")
    assert not Bounds(0, 1, below=True).allow(1) and Bounds(0, 1, below=True).allow(0)
