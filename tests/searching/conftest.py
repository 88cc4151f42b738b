"""A search in a folder of its own, without any training."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from searched import COMMAND, settings_of

from skatemount.config.search import SearchConfig
from skatemount.searching.folder import SearchFolder, open_folder
from skatemount.searching.study import SharedStudy


@pytest.fixture
def make_folder(runs_root: Path) -> Callable[..., SearchFolder]:
    """Opens the folder of the search, as another process would."""

    def make(settings: SearchConfig, experiment: str = "exp") -> SearchFolder:
        folder = open_folder(runs_root / experiment, "search", COMMAND, settings.dimensions())
        folder.total = settings.trials
        return folder

    return make


@pytest.fixture
def make_study(make_folder: Callable[..., SearchFolder]) -> Callable[..., SharedStudy]:
    """Opens the study of the search, as another process would."""
    pytest.importorskip("optuna")

    def make(experiment: str = "exp", **changed: Any) -> SharedStudy:
        settings = settings_of(**changed)
        return SharedStudy(make_folder(settings, experiment), settings, ["stage=balance"])

    return make
