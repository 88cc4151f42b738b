"""Registries of classes: types of parameters, and signatures. tests/config/test_registries.py has the rest."""

from __future__ import annotations

import math
from typing import Any, Literal, Optional

import pytest

from skatemount.utils.classes import ClassRegistry, check_value
from skatemount.utils.errors import ConfigError


@pytest.mark.parametrize(
    ("value", "kind"),
    [
        (1, int),
        (1, float),
        (1.5, float),
        (True, bool),
        ("a", str),
        (None, int | None),
        (None, Optional[int]),  # noqa: UP045
        ([1, 2], list[int]),
        (["a"], list),
        ("a", Literal["a", "b"]),
        (object(), Any),
    ],
)
def test_values_that_fit(value: Any, kind: Any) -> None:
    check_value(value, kind, "x")


@pytest.mark.parametrize(
    ("value", "kind", "words"),
    [
        (1.5, int, "a whole number"),
        (True, int, "a whole number"),
        (1, bool, "true or false"),
        (math.nan, float, "a finite number"),
        ("1", float | None, "a finite number or null"),
        ([1.5], list[int], "a list, each a whole number"),
        ("c", Literal["a", "b"], "a or b"),
        ({}, str, "text"),
    ],
)
def test_values_that_do_not_fit(value: Any, kind: Any, words: str) -> None:
    with pytest.raises(ConfigError) as error:
        check_value(value, kind, "network.params.x=1")
    assert str(error.value) == f"network.params.x=1 must be {words}"


class Base:
    """A class with a given parameter."""

    def __init__(self, config: Any, size: int = 3) -> None: ...

    def act(self) -> None: ...


class Derived(Base):
    def __init__(self, *args: Any, gain: float, **kwargs: Any) -> None: ...


def test_parameters_are_those_that_the_framework_does_not_give() -> None:
    registry = ClassRegistry("thing", {}, methods=("act",), base="Base", given=("config",))
    assert registry.parameters(Base) == {"size": (int, False)}
    assert registry.parameters(Derived) == {"gain": (float, True)}
    registry.register("derived")(Derived)
    registry.check()
    assert registry.names() == ["derived"] and registry.module("derived") == __name__
    with pytest.raises(ConfigError, match=r"^thing\.params\.gain is missing: Derived of .* needs it$"):
        registry.check_choice("derived", {}, "thing")
    assert registry.find("derived", "thing.kind") is Derived and registry.description("derived") == Base.__doc__


def test_a_snapshot_is_gone_back_to() -> None:
    registry = ClassRegistry("thing", {"json": "json:JSONDecoder"}, methods=("decode",), base="JSONDecoder")
    before = registry.snapshot()
    registry.register("mine")(Base)
    with pytest.raises(ConfigError, match="^thing 'mine': Base of .* lacks decode; see JSONDecoder$"):
        registry.check()
    registry.restore(before)
    assert registry.names() == ["json"] and registry.description("json").startswith("Simple JSON")
