"""Made-up records of episodes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch

from skatemount.evaluation.records import EpisodeRecords


def _records(n: int, **values: Any) -> EpisodeRecords:
    fields: dict[str, torch.Tensor] = dict(
        number=torch.arange(n),
        variant=torch.zeros(n, dtype=torch.int64),
        start=torch.zeros(n, 3),
        board_fixed=torch.ones(n, dtype=torch.bool),
        success=torch.zeros(n, dtype=torch.bool),
        end=torch.zeros(n, dtype=torch.int64),
        duration=torch.full((n,), 5.0),
    )
    metrics = dict(
        time_to_mount=torch.full((n,), torch.nan),
        feet_on_board=torch.zeros(n),
        board_displacement=torch.zeros(n),
        slips=torch.zeros(n, dtype=torch.int64),
        energy=torch.zeros(n),
    )
    for name, value in values.items():
        columns = metrics if name in metrics else fields
        columns[name] = torch.as_tensor(value).to(columns[name].dtype)
    return EpisodeRecords(**fields, metrics=metrics)


@pytest.fixture
def make_records() -> Callable[..., EpisodeRecords]:
    """Return `make_records(n, **fields)`: failed episodes of the task `mount`, with the given fields and metrics."""
    return _records
