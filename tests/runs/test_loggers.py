"""Metrics on disk: one line an iteration, safe if cut off, and TensorBoard events."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from skatemount.runs.folder import RunFolder
from skatemount.runs.loggers import as_numbers, open_loggers
from skatemount.runs.metrics import MetricsFile, read_metrics
from skatemount.utils.errors import ConfigError


@pytest.fixture
def run(runs_root: Path) -> RunFolder:
    return RunFolder.create(runs_root, "exp", "balance", {}, [])


def write(run: RunFolder, reports: list[tuple[int, dict[str, float]]], **options: Any) -> None:
    loggers = open_loggers(run, **options)
    for frames, metrics in reports:
        for logger in loggers:
            logger.log(metrics, frames)
    for logger in loggers:
        logger.close()


def rows(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def events(run: RunFolder, name: str) -> list[tuple[int, float]]:
    accumulator = EventAccumulator(str(run.path))
    accumulator.Reload()
    return [(event.step, event.value) for event in accumulator.Scalars(name)]


def test_file_and_events_hold_what_was_logged(run: RunFolder) -> None:
    write(run, [(100, {"Train/mean_reward": 0.1, "Success/rate": math.nan}), (200, {"Train/mean_reward": 0.5})])
    assert rows(run.metrics_file) == [
        {"frames": 100, "Train/mean_reward": 0.1, "Success/rate": None},
        {"frames": 200, "Train/mean_reward": 0.5},
    ]
    assert events(run, "Train/mean_reward") == [(100, pytest.approx(0.1)), (200, 0.5)]


def test_each_logger_can_be_switched_off(run: RunFolder) -> None:
    before = set(run.path.iterdir())
    write(run, [(1, {"a": 1.0})], file=False, tensorboard=False)
    assert set(run.path.iterdir()) == before
    assert [type(logger).__name__ for logger in open_loggers(run, tensorboard=False)] == ["JsonLinesLogger"]


def test_lines_are_readable_before_the_file_is_closed(tmp_path: Path) -> None:
    file = MetricsFile(tmp_path / "metrics.jsonl")
    file.log({"a": 1.0}, 1)
    assert read_metrics(tmp_path / "metrics.jsonl")["a"] == [1.0]
    file.close()


def test_metrics_that_a_line_lacks_are_nan(run: RunFolder) -> None:
    write(run, [(1, {"a": 1.0}), (2, {"b, quoted": 2.0}), (3, {"a": math.inf})], tensorboard=False)
    table = read_metrics(run.metrics_file)
    np.testing.assert_array_equal(table["frames"], [1, 2, 3])
    np.testing.assert_array_equal(table["a"], [1.0, math.nan, math.nan])
    np.testing.assert_array_equal(table["b, quoted"], [math.nan, 2.0, math.nan])


def test_resuming_drops_what_lies_beyond_the_checkpoint(run: RunFolder) -> None:
    write(run, [(frames, {"a": float(frames)}) for frames in (100, 200, 300)])
    write(run, [(300, {"a": -1.0, "b": 1.0})], frames=200)
    assert [(row["frames"], row["a"]) for row in rows(run.metrics_file)] == [(100, 100.0), (200, 200.0), (300, -1.0)]
    assert events(run, "a") == [(100, 100.0), (200, 200.0), (300, -1.0)]


@pytest.mark.parametrize("cut", ['{"frames": 300, "a": 3', '{"frames', '{"frames": 300, "a": 3.0}'])
def test_a_line_that_a_crash_cut_off_is_dropped(tmp_path: Path, cut: str) -> None:
    path, whole = tmp_path / "metrics.jsonl", '{"frames": 100, "a": 1.0}\n{"frames": 200, "a": 2.0}\n'
    path.write_text(whole + cut)
    np.testing.assert_array_equal(read_metrics(path)["frames"], [100, 200])
    file = MetricsFile(path)
    file.log({"a": 5.0}, 300)
    file.close()
    assert path.read_text() == whole + '{"frames": 300, "a": 5.0}\n'


@pytest.mark.parametrize("cut", ["", "300,3", "300", '300,"3'])
def test_a_table_of_an_older_version_is_read_and_converted_once(tmp_path: Path, cut: str) -> None:
    old, path = tmp_path / "metrics.csv", tmp_path / "metrics.jsonl"
    old.write_text(f'frames,a,"b, quoted"\n100,1.5,\n200,nan,2.0\n{cut}')
    table = read_metrics(old)
    np.testing.assert_array_equal(table["frames"], [100, 200])
    np.testing.assert_array_equal(table["a"], [1.5, math.nan])
    file = MetricsFile(path, resume_at=100)
    file.log({"a": 5.0}, 150)
    file.close()
    assert rows(path) == [{"frames": 100, "a": 1.5}, {"frames": 150, "a": 5.0}]
    assert not old.exists()


@pytest.mark.parametrize(("name", "text"), [("m.csv", "x,y\n1,2\n"), ("m.jsonl", '{"x": 1}\n'), ("m.jsonl", "[1]\n")])
def test_files_that_hold_something_else_are_refused(tmp_path: Path, name: str, text: str) -> None:
    path = tmp_path / name
    path.write_text(text)
    for use in (read_metrics, MetricsFile):
        with pytest.raises(ConfigError, match=f"{name}.*frames") as error:
            use(path.with_suffix(".jsonl") if use is MetricsFile else path)
        assert "\n" not in str(error.value)
    assert path.read_text() == text
    with pytest.raises(ConfigError, match="none.jsonl"):
        read_metrics(tmp_path / "none.jsonl")


def test_metrics_become_floats_and_what_is_no_number_is_named() -> None:
    assert as_numbers({"a": torch.tensor(0.5), "b": np.float32(0.25), "c": 1}) == {"a": 0.5, "b": 0.25, "c": 1.0}
    with pytest.raises(ValueError, match="Loss/kl='x'"):
        as_numbers({"Loss/kl": "x"})  # type: ignore[dict-item]


def test_missing_tensorboard_is_one_clear_line(run: RunFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    with pytest.raises(ConfigError, match="logger.tensorboard=false"):
        open_loggers(run)
