"""The learning curve of trainings that follow one another."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from skatemount.runs.folder import RunFolder
from skatemount.runs.metrics import MetricsFile
from skatemount.training.plots import COLORS, plot_chain, plot_learning_curves
from skatemount.utils.errors import ConfigError


def write_table(path: Path, count: int = 60) -> Path:
    table = MetricsFile(path)
    for i in range(1, count + 1):
        values = {"Success/rate": 0.5 * i / count, "Train/mean_reward": float(i), "Perf/elapsed_s": 10.0 * i}
        table.log(values | ({"Evaluation/success": i / count} if i % 5 == 0 else {}), 1000 * i)
    table.close()
    return path


def columns(path: Path, colour: str) -> np.ndarray:
    """Columns of the picture that have pixels of a line's color."""
    pixels = (255 * imread(path)[:, :, :3]).round()
    wanted = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)])
    return np.nonzero((pixels == wanted).all(-1).sum(0) > 0)[0]


def test_each_training_has_a_colour_and_they_follow_one_another(tmp_path: Path) -> None:
    # The later one is twice as long. Its legend, on the left, is not counted: the line alone reaches the right edge.
    runs = [("one", write_table(tmp_path / "1.jsonl", 60)), ("two", write_table(tmp_path / "2.jsonl", 120))]
    plot_chain([*runs, ("three", tmp_path / "none.jsonl")], tmp_path / "a.png", "a $title")
    width = imread(tmp_path / "a.png").shape[1]
    first, second = (columns(tmp_path / "a.png", colour) for colour in COLORS[:2])
    assert 0.3 * width < first.max() < 0.45 * width
    assert second.max() > 0.95 * width
    assert not len(columns(tmp_path / "a.png", COLORS[2]))
    with pytest.raises(ConfigError, match="no metrics"):
        plot_chain([("none", tmp_path / "none.jsonl")], tmp_path / "b.png")


def test_the_tool_draws_runs_and_chains(
    tmp_path: Path, repo_root: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    config = {"stage": {"name": "mount"}, "curriculum": {"kind": "auto"}}
    single = RunFolder.create(tmp_path, "exp", "mount", config, [])
    chain = RunFolder.create(tmp_path, "exp", "paper", {}, [])
    for i in (10, 9):
        write_table(chain.create_part(f"{i}_part", config, []).metrics_file)
    write_table(single.metrics_file)
    assert [part.path.name for part in chain.parts] == ["9_part", "10_part"]

    tool = str(repo_root / "tools" / "plot_training.py")

    def call(*arguments: object) -> None:
        monkeypatch.setattr(sys, "argv", [tool, *map(str, arguments)])
        runpy.run_path(tool, run_name="__main__")

    picture = tmp_path / "out.png"
    call(single.path, chain.path, picture)
    assert str(picture) in capsys.readouterr().out
    assert all(len(columns(picture, colour)) for colour in COLORS[:3])
    with pytest.raises(SystemExit) as error:
        call(tmp_path / "nothing", picture)
    assert "not a run folder" in str(error.value)


def write_metrics(path: Path, names: list[str], count: int = 60) -> None:
    path.unlink(missing_ok=True)
    table = MetricsFile(path)
    for i in range(1, count + 1):
        table.log({name: 0.5 * i / count for name in names}, 1000 * i)
    table.close()


def test_plot_draws_what_there_is_and_replaces_the_old_picture(tmp_path: Path) -> None:
    metrics, png = tmp_path / "metrics.jsonl", tmp_path / "curves.png"
    write_metrics(metrics, ["Train/mean_reward"])
    plot_learning_curves(metrics, png)
    few = imread(png)
    write_metrics(
        metrics,
        ["Success/rate", "Evaluation/success", "Loss/kl", "Loss/learning_rate", "Perf/elapsed_s"],
    )
    plot_learning_curves(metrics, png, "a $title_with^odd signs")
    assert imread(png).shape == few.shape
    assert not np.array_equal(imread(png), few)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["curves.png", "metrics.jsonl"]


def test_plot_leaves_no_figures_open(tmp_path: Path) -> None:
    from matplotlib import _pylab_helpers

    write_metrics(tmp_path / "m.jsonl", ["Success/rate"], 1)
    plot_learning_curves(tmp_path / "m.jsonl", tmp_path / "m.png")
    assert _pylab_helpers.Gcf.figs == {}


def test_plot_of_an_empty_table_says_so(tmp_path: Path) -> None:
    write_metrics(tmp_path / "m.jsonl", ["a"], 0)
    with pytest.raises(ConfigError, match="no rows"):
        plot_learning_curves(tmp_path / "m.jsonl", tmp_path / "m.png")


def test_the_table_of_an_older_version_is_drawn(tmp_path: Path) -> None:
    (tmp_path / "metrics.csv").write_text("frames,Success/rate\n1000,0.5\n2000,\n3000,1.0\n")
    plot_learning_curves(tmp_path / "metrics.csv", tmp_path / "curves.png")
    assert len(columns(tmp_path / "curves.png", COLORS[0]))
