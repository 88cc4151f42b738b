"""The mixture draws from all bins alike, whatever the successes."""

from __future__ import annotations

import defaults
import torch
from ended import finish

from skatemount.config import compose
from skatemount.curriculum.base import make_curriculum
from skatemount.curriculum.mixture import MixtureCurriculum


def mixture(**settings: object) -> MixtureCurriculum:
    return MixtureCurriculum(defaults.curriculum(kind="mixture", **settings), 0.088)  # type: ignore[arg-type]


def test_every_bin_is_drawn_as_often_from_the_first_iteration() -> None:
    each = mixture(stage_range_fraction=0.4)
    bins = len(each.opened)
    place = each.sample_poses(100 * bins, torch.Generator().manual_seed(0))
    counts = torch.bincount(place.bin, minlength=bins)
    assert counts.min() > 50 and counts.max() < 160
    assert place.board_fixed.float().mean().sub(0.5).abs() < 0.02
    assert place.from_stage_ranges is not None
    assert place.from_stage_ranges.float().mean().sub(0.4).abs() < 0.02


def test_successes_are_counted_and_change_no_start() -> None:
    each = mixture()
    before = each.weights().clone()
    for _ in range(5):
        finish(each, torch.zeros(100, dtype=torch.int64), good=True)
        each.update()
    assert torch.equal(each.weights(), before)
    assert each.episodes[0] == each.config.window and each.rates()[0] > 0.9
    assert each.metrics()["Curriculum/bins_open"] == 1.0


def test_its_file_makes_one() -> None:
    made = make_curriculum(compose("unfixed", ["curriculum=mixture"]).curriculum, 0.088)
    assert isinstance(made, MixtureCurriculum) and made.shape[-1] == 2
