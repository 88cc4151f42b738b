from __future__ import annotations

import csv
import io
import math
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from rich.console import Console
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from skatemount.runs.folder import RunFolder
from skatemount.runs.loggers import MetricsLog
from skatemount.runs.metrics import MetricsCsv, read_metrics
from skatemount.training import progress
from skatemount.training.plots import plot_learning_curves
from skatemount.training.progress import Progress
from skatemount.utils.errors import ConfigError
from skatemount.utils.formatting import format_count, format_duration


@pytest.fixture
def run(runs_root: Path) -> RunFolder:
    return RunFolder.create(runs_root, "exp", "balance", {}, [])


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_csv_and_events_hold_what_was_logged(run: RunFolder) -> None:
    with MetricsLog(run) as log:
        log.log({"Train/mean_reward": 0.1, "Success/rate": float("nan")}, 100)
        log.log({"Train/mean_reward": torch.tensor(0.5), "Success/rate": np.float32(0.25)}, 200)
    assert rows(run.metrics_csv) == [
        {"frames": "100", "Train/mean_reward": "0.1", "Success/rate": "nan"},
        {"frames": "200", "Train/mean_reward": "0.5", "Success/rate": "0.25"},
    ]
    events = EventAccumulator(str(run.path))
    events.Reload()
    assert [(e.step, e.value) for e in events.Scalars("Train/mean_reward")] == [
        (100, pytest.approx(0.1)),
        (200, 0.5),
    ]


def test_each_log_can_be_switched_off(run: RunFolder) -> None:
    before = set(run.path.iterdir())
    with MetricsLog(run, tensorboard=False, csv=False) as log:
        log.log({"a": 1.0}, 1)
    assert set(run.path.iterdir()) == before


def test_rows_are_readable_before_the_log_is_closed(run: RunFolder) -> None:
    log = MetricsLog(run, tensorboard=False)
    log.log({"a": 1.0}, 1)
    assert read_metrics(run.metrics_csv)["a"] == [1.0]
    log.close()


def test_columns_grow_and_missing_cells_stay_empty(run: RunFolder) -> None:
    with MetricsLog(run, tensorboard=False) as log:
        log.log({"a": 1.0}, 1)
        log.log({"b, quoted": 2.0}, 2)
        log.log({"a": 3.0}, 3)
    assert run.metrics_csv.read_text().splitlines() == [
        'frames,a,"b, quoted"', "1,1.0,", "2,,2.0", "3,3.0,",
    ]  # fmt: skip
    table = read_metrics(run.metrics_csv)
    np.testing.assert_array_equal(table["a"], [1.0, math.nan, 3.0])


def test_resuming_drops_what_lies_beyond_the_checkpoint(run: RunFolder) -> None:
    with MetricsLog(run) as log:
        for frames in (100, 200, 300):
            log.log({"a": float(frames)}, frames)
    with MetricsLog(run, resume_at=200) as log:
        log.log({"a": -1.0, "b": 1.0}, 300)
    assert [(r["frames"], r["a"]) for r in rows(run.metrics_csv)] == [
        ("100", "100.0"), ("200", "200.0"), ("300", "-1.0"),
    ]  # fmt: skip
    events = EventAccumulator(str(run.path))
    events.Reload()
    assert [(e.step, e.value) for e in events.Scalars("a")] == [
        (100, 100.0), (200, 200.0), (300, -1.0),
    ]  # fmt: skip


@pytest.mark.parametrize("cut", ["300,3", "300", '300,"3'])
def test_a_row_that_a_crash_cut_off_is_dropped(tmp_path: Path, cut: str) -> None:
    path = tmp_path / "metrics.csv"
    path.write_text(f"frames,a\n100,1.0\n200,2.0\n{cut}")
    np.testing.assert_array_equal(read_metrics(path)["frames"], [100, 200])
    table = MetricsCsv(path)
    table.append({"a": 5.0}, 300)
    table.close()
    assert path.read_text() == "frames,a\n100,1.0\n200,2.0\n300,5.0\n"


def test_tables_that_are_not_ours_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "metrics.csv"
    path.write_text("x,y\n1,2\n")
    for use in (MetricsCsv, read_metrics):
        with pytest.raises(ConfigError, match="frames"):
            use(path)
    with pytest.raises(ConfigError, match="none.csv"):
        read_metrics(tmp_path / "none.csv")


def test_a_metric_that_is_no_number_is_named(run: RunFolder) -> None:
    log = MetricsLog(run, tensorboard=False)
    with pytest.raises(ValueError, match="Loss/kl='x'"):
        log.log({"Loss/kl": "x"}, 1)  # type: ignore[dict-item]
    log.close()


def test_missing_tensorboard_is_one_clear_line(run: RunFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    with pytest.raises(ConfigError, match="logger.tensorboard=false"):
        MetricsLog(run)


def pixels(path: Path) -> np.ndarray:
    from matplotlib.image import imread

    return imread(path)


def write_table(path: Path, names: list[str], count: int = 60) -> None:
    table = MetricsCsv(path)
    for i in range(1, count + 1):
        table.append({name: 0.5 * i / count for name in names}, 1000 * i)
    table.close()


def test_plot_draws_what_there_is_and_replaces_the_old_picture(tmp_path: Path) -> None:
    csv_path, png = tmp_path / "metrics.csv", tmp_path / "curves.png"
    write_table(csv_path, ["Train/mean_reward"])
    plot_learning_curves(csv_path, png)
    few = pixels(png)
    write_table(
        csv_path,
        ["Success/rate", "Evaluation/success", "Loss/kl", "Loss/learning_rate", "Perf/elapsed_s"],
    )
    plot_learning_curves(csv_path, png, "a $title_with^odd signs")
    assert pixels(png).shape == few.shape
    assert not np.array_equal(pixels(png), few)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["curves.png", "metrics.csv"]


def test_plot_leaves_no_figures_open(tmp_path: Path) -> None:
    from matplotlib import _pylab_helpers

    write_table(tmp_path / "m.csv", ["Success/rate"], 1)
    plot_learning_curves(tmp_path / "m.csv", tmp_path / "m.png")
    assert _pylab_helpers.Gcf.figs == {}


def test_plot_of_an_empty_table_says_so(tmp_path: Path) -> None:
    write_table(tmp_path / "m.csv", ["a"], 0)
    with pytest.raises(ConfigError, match="no rows"):
        plot_learning_curves(tmp_path / "m.csv", tmp_path / "m.png")


class FakeTime:
    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 100.0
        monkeypatch.setattr(progress.time, "monotonic", lambda: self.now)


def test_plain_progress_is_one_line_every_few_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    time, out = FakeTime(monkeypatch), io.StringIO()
    progress = Progress(10_000, "balance", every_s=5.0, console=Console(file=out))
    for i in range(1, 11):
        time.now += 1.0
        metrics = {"Train/mean_reward": i, "Success/rate": 0.5} if i == 1 else {"Loss/kl": 0.01}
        progress.update(i * 500, metrics)
    progress.close()
    lines = out.getvalue().splitlines()
    assert len(lines) == 3  # at 1 s, at 6 s, and the last state
    assert "(5%)" in lines[0] and "(30%)" in lines[1] and "(50%)" in lines[2]
    # Values stay until there are newer ones; half is done after 10 s, so 10 s are left.
    for part in ("balance", "5.0k/10.0k", "success 0.50", "reward 1.00", "kl 0.0100",
                 "steps/s 500", "elapsed 0:10", "left 0:10"):  # fmt: skip
        assert part in lines[2]
    assert "\x1b" not in out.getvalue()


def test_time_left_of_a_resumed_run_counts_its_own_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    time, out = FakeTime(monkeypatch), io.StringIO()
    progress = Progress(10_000, "x", initial_frames=8_000, console=Console(file=out))
    time.now += 10.0
    progress.update(9_000, {})
    assert "left 0:10" in out.getvalue()


def test_terminal_progress_is_a_live_table() -> None:
    out = io.StringIO()
    console = Console(file=out, force_terminal=True, width=80)
    with Progress(1000, "mount [bold]", console=console) as progress:
        progress.update(250, {"Success/rate": 0.75, "Loss/learning_rate": 1e-3})
        progress.update(500, {"Success/rate": math.nan})
    text = out.getvalue()
    assert "success" in text and "0.75" in text and "1.0e-03" in text and "mount [bold]" in text
    assert "\x1b[?25h" in text  # the cursor is back


def test_short_forms() -> None:
    assert [format_count(x) for x in (950, 15_230, 1.2e6, 3e9)] == ["950", "15.2k", "1.20M", "3.00G"]
    assert [format_duration(x) for x in (9, 83, 7511, math.inf)] == ["0:09", "1:23", "2:05:11", "-"]
