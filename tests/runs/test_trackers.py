"""Experiment trackers: what they get, and that a run that resumes stays one run; with the real packages, offline."""

from __future__ import annotations

import importlib.util
import json
import os
import sqlite3
import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tiny import BATCH, TINY

from skatemount.config import compose
from skatemount.runs.folder import RunFolder
from skatemount.runs.loggers import open_loggers
from skatemount.runs.trackers import Tracker
from skatemount.utils.errors import ConfigError


@pytest.fixture
def run(runs_root: Path) -> RunFolder:
    return RunFolder.create(runs_root, "exp", "balance", {"seed": 3, "logger": {"experiment": "exp"}}, [])


class Remote(Tracker):
    """A tracker that keeps what it gets, of a package that is there."""

    PACKAGE = "json"

    def _open(self, identity: str, name: str, project: str) -> Any:
        self.opened, self.sent, self.ended = (identity, name, project), [], 0
        self.settings: Any = None
        self.experiment = self
        return self

    def log_hparams(self, settings: Any) -> None:
        self.settings = settings

    def finish(self) -> None:
        self.ended += 1

    def _send(self, metrics: dict[str, float], frames: int) -> None:
        self.sent.append((frames, metrics))

    def _media(self, path: Path) -> Any:
        return path.read_text()

    # `log` of TorchRL's logger and of the tracker differ in their arguments.
    def log(self, metrics: Any, frames: int = 0, step: int | None = None) -> None:
        if step is None:
            super().log(metrics, frames)
        else:
            self.sent.append((step, metrics))


def test_settings_metrics_and_files_are_sent_once(run: RunFolder) -> None:
    tracker = Remote(run)
    assert tracker.settings == run.config and tracker.opened[1:] == (run.path.name, "exp")
    tracker.log({"a": 1.0}, 10)
    run.curves_png.write_text("first")
    tracker.log({"a": 2.0}, 20)
    tracker.log({"a": 3.0}, 30)
    run.curves_png.write_text("second")
    os.utime(run.curves_png, (1, 1))
    (run.videos / "x.mp4").write_text("film")
    tracker.close()
    tracker.close()
    assert tracker.sent == [
        (10, {"a": 1.0}),
        (20, {"a": 2.0}),
        (20, {"Picture/curves": "first", "frames": 20}),
        (30, {"a": 3.0}),
        (30, {"Picture/curves": "second", "Film/x": "film", "frames": 30}),
    ]
    assert tracker.ended == 1
    again = Remote(run, 30)
    (run.videos / "y.mp4").write_text("film of another command")
    again.close()
    assert again.opened == tracker.opened
    assert again.sent == [(30, {"Film/y": "film of another command", "frames": 30})]


def test_a_part_and_a_job_have_the_whole_name(run: RunFolder) -> None:
    part = run.create_part("1_gait", {"logger": {"experiment": "exp"}}, [])
    assert Remote(part).opened[1] == f"{run.path.name}.1_gait"
    (run.path.parent / "sweep.json").write_text("{}")
    assert Remote(part).opened[1] == f"{run.path.name}.1_gait"
    assert Remote(run).opened[1] == f"exp.{run.path.name}"


@pytest.mark.parametrize("name", ["wandb", "trackio"])
def test_a_missing_package_is_one_line_that_names_the_extra(
    name: str, run: RunFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert compose("balance", [f"logger={name}"]).logger.loggers == [name]
    monkeypatch.setattr(importlib.util, "find_spec", lambda package: None)
    with pytest.raises(ConfigError) as error:
        open_loggers(run, tensorboard=False, others=[name])
    assert str(error.value) == (
        f"logger.loggers={name}: the package {name} is not installed: pip install 'skatemount[{name}]', or "
        "logger.loggers=[]"
    )


def test_a_run_without_a_frame_is_removed_with_what_trackers_wrote(run: RunFolder) -> None:
    (run.path / "wandb" / "offline-run").mkdir(parents=True)
    (run.path / "wandb" / "offline-run" / "run.wandb").write_text("much")
    (run.path / "wandb.json").write_text("{}")
    assert run.remove_unused() and not run.path.exists()


TRAINING = """
import sys
from pathlib import Path

from skatemount.cli import run
from skatemount.train import train

first, second = sys.argv[1].split(), sys.argv[2].split()
sys.argv = ["train", *first]
run(train, "train")
folder = next(Path("runs/mine").iterdir())
(folder / "videos").mkdir()
(folder / "videos" / "episode7.mp4").write_bytes(b"film")
sys.argv = ["train", *second, f"resume={folder}"]
run(train, "train")
"""


@pytest.fixture(scope="module")
def tracked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a training of three iterations that both trackers got, and that resumed for two more."""
    folder = tmp_path_factory.mktemp("tracked")
    own = {"WANDB_MODE": "offline", "TRACKIO_DIR": str(folder / "trackio"), "WANDB_SILENT": "true"}
    first = [*TINY, "stage=balance", f"total_frames={3 * BATCH}", "logger.root=runs", "logger.experiment=mine",
             "logger=wandb", "logger.loggers=[wandb,trackio]", "logger.plot_every=0"]  # fmt: skip
    second = ["logger.root=runs", f"total_frames={5 * BATCH}"]
    subprocess.run(
        [sys.executable, "-c", TRAINING, " ".join(first), " ".join(second)],
        cwd=folder,
        env=os.environ | own,
        check=True,
        timeout=900,
    )
    return folder


def records(path: Path) -> Iterator[Any]:
    """Yield the records of a file that W&B wrote offline: a log in blocks of 32 KiB, as LevelDB has it."""
    from wandb.proto import wandb_internal_pb2

    data, at, part = path.read_bytes(), 7, b""
    while at < len(data):
        if (left := 2**15 - at % 2**15) < 7:
            at += left
            continue
        _, length, kind = struct.unpack("<IHB", data[at : at + 7])
        part += data[at + 7 : at + 7 + length]
        at += 7 + length
        if kind in (1, 4):  # a whole record, or its last part
            record = wandb_internal_pb2.Record()
            record.ParseFromString(part)
            part = b""
            yield record


@pytest.mark.slow
def test_wandb_has_one_run_with_frames_as_its_step(tracked: Path) -> None:
    run = next((tracked / "runs" / "mine").iterdir())
    rows: dict[int, dict[str, Any]] = {}
    runs, config, metrics = set(), {}, set()
    for file in sorted(run.glob("wandb/offline-run-*/*.wandb")):
        for record in records(file):
            kind = record.WhichOneof("record_type")
            if kind == "run":
                runs.add((record.run.run_id, record.run.project, record.run.display_name))
            elif kind == "config":
                config |= {item.key: json.loads(item.value_json) for item in record.config.update}
            elif kind == "metric":
                metrics.add((record.metric.glob_name, record.metric.step_metric))
            elif kind == "history":
                items = {item.nested_key[0]: json.loads(item.value_json) for item in record.history.item}
                rows.setdefault(record.history.step.num, {}).update(items)
    assert len(runs) == 1 and next(iter(runs))[1:] == ("mine", run.name)
    assert config["physics"]["num_worlds"] == 8 and ("*", "frames") in metrics
    assert sorted(rows) == [BATCH * i for i in range(1, 6)]
    logged = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    for line in logged:
        row = rows[line["frames"]]
        assert row["frames"] == line["frames"] and row["Loss/kl"] == pytest.approx(line["Loss/kl"])
    assert "Picture/curves" in rows[3 * BATCH] and "Film/episode7" in rows[4 * BATCH]
    assert len(list(run.glob("wandb/offline-run-*/files/media/videos/Film/*.mp4"))) == 1


@pytest.mark.slow
def test_trackio_has_one_run_with_frames_as_its_step(tracked: Path) -> None:
    run = next((tracked / "runs" / "mine").iterdir())
    with sqlite3.connect(tracked / "trackio" / "mine.db") as database:
        rows = database.execute("select run_id, run_name, step, metrics from metrics order by id").fetchall()
        (config,) = database.execute("select config from configs order by id limit 1").fetchone()
    assert len({row[:2] for row in rows}) == 1 and rows[0][1] == run.name
    assert json.loads(config)["physics"]["num_worlds"] == 8
    values: dict[int, dict[str, Any]] = {}
    for _, _, step, metrics in rows:
        values.setdefault(step, {}).update(json.loads(metrics))
    assert sorted(values) == [BATCH * i for i in range(1, 6)]
    for line in map(json.loads, (run / "metrics.jsonl").read_text().splitlines()):
        row = values[line["frames"]]
        assert row["frames"] == line["frames"] and row["Loss/kl"] == pytest.approx(line["Loss/kl"])
    assert "Picture/curves" in values[3 * BATCH] and "Film/episode7" in values[4 * BATCH]
    assert list((tracked / "trackio" / "media").rglob("*.mp4"))
