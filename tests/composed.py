"""Composed settings and refused ones, for the tests of the configuration."""

from __future__ import annotations

import functools

import pytest

from skatemount.config import TrainConfig, compose
from skatemount.utils.errors import ConfigError


@functools.cache
def stage_config(stage: str) -> TrainConfig:
    """Return the settings of a stage; do not change them, because several tests share them."""
    return compose(stage)


def one_line(error: pytest.ExceptionInfo[ConfigError]) -> str:
    """Return the text of an error after checking that it is one readable line."""
    text = str(error.value)
    assert text and "\n" not in text
    assert "$VALUE" not in text and len(text) < 800
    return text
