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
        mount_time=torch.full((n,), torch.nan),
        feet=torch.zeros(n),
        displacement=torch.zeros(n),
        slips=torch.zeros(n, dtype=torch.int64),
        energy=torch.zeros(n),
    )
    for name, value in values.items():
        fields[name] = torch.as_tensor(value).to(fields[name].dtype)
    return EpisodeRecords(**fields)


@pytest.fixture
def make_records() -> Callable[..., EpisodeRecords]:
    """Return `make_records(n, **fields)`: failed episodes, not mounted at the time limit, with the given fields."""
    return _records
