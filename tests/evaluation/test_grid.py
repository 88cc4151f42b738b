"""Grids: results over two quantities, as tables, JSON and a picture."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from PIL import Image

from skatemount.config.suite import SuiteConfig
from skatemount.envs.tasks import TASKS
from skatemount.evaluation import report
from skatemount.evaluation.grid import plot_grid
from skatemount.evaluation.records import EpisodeRecords
from skatemount.evaluation.results import Evaluation
from skatemount.utils.errors import ConfigError

GRID = {"curvature": {"-0.5": ["a=1"], "0": ["a=2"], "0.5": ["a=3"]}, "speed": {"0.3": ["b=1"], "1": ["b=2"]}}
SUITE = SuiteConfig(name="own", stage="balance", grid=GRID)


def evaluation(make_records: Callable[..., EpisodeRecords]) -> Evaluation:
    """Return results of 4 episodes in each cell but the last, in which cell i has i successes."""
    n = 5
    success = [turn < i for turn in range(4) for i in range(n)]
    records = make_records(4 * n, success=success, variant=[*range(n)] * 4)
    about = {"definition": vars(SUITE)}
    return Evaluation(records, ["not_mounted"], TASKS.get("mount"), variants=list(SUITE.variants), evaluated=about)


def test_every_pair_is_a_variant() -> None:
    assert list(SUITE.variants) == ["-0.5, 0.3", "-0.5, 1", "0, 0.3", "0, 1", "0.5, 0.3", "0.5, 1"]
    assert SUITE.variants["0, 1"] == ["a=2", "b=2"]


def test_cells_are_in_their_places(make_records: Callable[..., EpisodeRecords]) -> None:
    result = evaluation(make_records)
    grid = result.grid()
    assert grid is not None
    # Variants go down first: 0, 1 and 2 of 4 episodes succeeded in the cells of the first column and a half.
    document = json.loads(json.dumps(result.to_dict()["grid"], allow_nan=False))
    assert document["across"] == {"quantity": "curvature", "steps": ["-0.5", "0", "0.5"]}
    assert document["values"]["success"] == [[0.0, 0.5, 1.0], [0.25, 0.75, None]]
    text = report.table(result)
    rows = [words for line in text.splitlines() if (words := line.split())[:1] in (["0.3"], ["1"])]
    assert rows[:2] == [["0.3", "0.00", "0.50", "1.00"], ["1", "0.25", "0.75", "-"]]


def test_the_picture_has_its_panels(make_records: Callable[..., EpisodeRecords], tmp_path: Path) -> None:
    grid = evaluation(make_records).grid()
    assert grid is not None
    plot_grid(grid, "a title", tmp_path / "grid.png")
    with Image.open(tmp_path / "grid.png") as picture:
        assert picture.width > 1000 and len(picture.convert("RGB").getcolors(10**7)) > 50


def test_without_a_grid_there_is_none(make_records: Callable[..., EpisodeRecords]) -> None:
    result = evaluation(make_records)
    result.evaluated["definition"] = {"version": 1}
    assert result.grid() is None and "grid" not in result.to_dict()


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (dict(grid={"curvature": {"0": []}}), r"^suite\.grid=\['curvature'\]: a grid has two quantities"),
        (dict(grid=GRID, ladder="speed"), r"^suite\.ladder='speed': a suite with a grid is no ladder"),
    ],
)
def test_mistakes_are_one_line(settings: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        SuiteConfig(name="own", stage="balance", **settings).validate()  # type: ignore[arg-type]
