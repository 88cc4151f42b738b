"""The learning curve of trainings that follow one another."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from skatemount.runs.folder import RunFolder
from skatemount.runs.metrics import MetricsCsv
from skatemount.training.plots import COLOURS, plot_chain
from skatemount.utils.errors import ConfigError


def write_table(path: Path, count: int = 60) -> Path:
    table = MetricsCsv(path)
    for i in range(1, count + 1):
        values = {"Success/rate": 0.5 * i / count, "Train/mean_reward": float(i), "Perf/elapsed_s": 10.0 * i}
        table.append(values | ({"Evaluation/success": i / count} if i % 5 == 0 else {}), 1000 * i)
    table.close()
    return path


def columns(path: Path, colour: str) -> np.ndarray:
    """Which columns of the picture have pixels of a line's colour."""
    pixels = (255 * imread(path)[:, :, :3]).round()
    wanted = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)])
    return np.nonzero((pixels == wanted).all(-1).sum(0) > 0)[0]


def test_each_training_has_a_colour_and_they_follow_one_another(tmp_path: Path) -> None:
    # The later one is twice as long. Its legend, on the left, is not counted: the line alone reaches the right edge.
    runs = [("one", write_table(tmp_path / "1.csv", 60)), ("two", write_table(tmp_path / "2.csv", 120))]
    plot_chain([*runs, ("three", tmp_path / "none.csv")], tmp_path / "a.png", "a $title")
    width = imread(tmp_path / "a.png").shape[1]
    first, second = (columns(tmp_path / "a.png", colour) for colour in COLOURS[:2])
    assert 0.3 * width < first.max() < 0.45 * width
    assert second.max() > 0.95 * width
    assert not len(columns(tmp_path / "a.png", COLOURS[2]))
    with pytest.raises(ConfigError, match="no metrics"):
        plot_chain([("none", tmp_path / "none.csv")], tmp_path / "b.png")


def test_the_tool_draws_runs_and_chains(
    tmp_path: Path, repo_root: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    config = {"stage": {"name": "mount"}, "curriculum": {"kind": "auto"}}
    single = RunFolder.create(tmp_path, "exp", "mount", config, [])
    chain = RunFolder.create(tmp_path, "exp", "paper", {}, [])
    for i in (10, 9):
        write_table(chain.create_part(f"{i}_part", config, []).metrics_csv)
    write_table(single.metrics_csv)
    assert [part.path.name for part in chain.parts] == ["9_part", "10_part"]

    tool = str(repo_root / "tools" / "plot_training.py")

    def call(*arguments: object) -> None:
        monkeypatch.setattr(sys, "argv", [tool, *map(str, arguments)])
        runpy.run_path(tool, run_name="__main__")

    picture = tmp_path / "out.png"
    call(single.path, chain.path, picture)
    assert str(picture) in capsys.readouterr().out
    assert all(len(columns(picture, colour)) for colour in COLOURS[:3])
    with pytest.raises(SystemExit) as error:
        call(tmp_path / "nothing", picture)
    assert "not a run folder" in str(error.value)
