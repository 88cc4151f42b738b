"""Shared by the tests of the configuration."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from skatemount.config import config_dir


@pytest.fixture(autouse=True)
def forget_where_the_settings_lie() -> Iterator[None]:
    """Look the folder of the settings up again in the next test, because some tests replace it."""
    yield
    config_dir.cache_clear()
