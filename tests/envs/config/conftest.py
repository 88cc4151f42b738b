"""Settings to change one at a time."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable
from typing import Any

import pytest

from skatemount.config import TrainConfig, compose

_COMPOSED: list[TrainConfig] = []


@pytest.fixture
def make_settings() -> Callable[..., Any]:
    """A group of the composed settings with some of them changed: `make_settings(group, **changes)`."""
    if not _COMPOSED:
        _COMPOSED.append(compose("mount"))

    def make(group: str, **changes: Any) -> Any:
        return dataclasses.replace(copy.deepcopy(getattr(_COMPOSED[0], group)), **changes)

    return make
