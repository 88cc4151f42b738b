"""The success map: rates by position, and the picture."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import defaults
import numpy as np
import pytest
import torch
from PIL import Image

from skatemount.envs.tasks import TASKS
from skatemount.evaluation.records import EpisodeRecords
from skatemount.evaluation.results import Evaluation
from skatemount.evaluation.success_map import plot_success_map, rates_by_place


def test_cells_count_the_episodes_that_started_in_them() -> None:
    generator = np.random.default_rng(0)
    xy = generator.uniform((-0.6, -0.3), (0.6, 0.3), (3000, 2))
    xy = xy[(xy[:, 0] < 0) | (xy[:, 1] > 0)]  # a quarter is empty
    success = xy[:, 0] > 0.2
    x, y, rates = rates_by_place(xy, success)
    assert rates.shape == (len(x) - 1, len(y) - 1)
    cells = np.diff(x)[0], np.diff(y)[0]
    assert cells[0] == pytest.approx(cells[1], rel=0.1)  # nearly square
    assert len(xy) / rates.size == pytest.approx(12, rel=0.2)
    assert np.nanmax(rates[x[1:] < 0.2]) == 0 and np.nanmin(rates[x[:-1] > 0.2]) == 1
    right, lower = x[:-1] > 0, y[1:] < 0
    assert np.isnan(rates[right][:, lower]).all()
    assert not np.isnan(rates[~right]).any()


def test_starts_that_are_all_alike_are_one_cell() -> None:
    _, _, rates = rates_by_place(np.zeros((4, 2)), np.array([True, False, True, True]))
    assert np.nanmean(rates) == 0.75 and np.isfinite(rates).sum() == 1


@pytest.mark.parametrize("successes", [0, 150, 300])
@pytest.mark.parametrize("spread", [0.03, 1.5])
def test_draws_it(make_records: Callable[..., EpisodeRecords], tmp_path: Path, successes: int, spread: float) -> None:
    start = spread * (2 * torch.rand(300, 3, generator=torch.Generator().manual_seed(0)) - 1)
    records = make_records(300, start=start, success=torch.arange(300) < successes)
    path = tmp_path / "a.png"
    plot_success_map(Evaluation(records, ["not_mounted"], TASKS.get("mount")), [defaults.board()], path)
    with Image.open(path) as picture:
        pixels = np.asarray(picture.convert("RGB")).reshape(-1, 3)
    red = (np.abs(pixels.astype(int) - (214, 39, 40)) < 30).all(1).sum()
    assert (red > 50) == (successes < 300)  # failures are seen, and only they are red
