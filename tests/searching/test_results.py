"""Results of a search: its table, its files, its picture, and the best settings as an experiment."""

from __future__ import annotations

import csv
import json
import shlex
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from matplotlib import image

from skatemount.config import compose_program, set_user_config_dir, to_dict
from skatemount.config.schema import TrainConfig
from skatemount.reports.sweep_page import read_group
from skatemount.runs.sweep import Score
from skatemount.searching import results
from skatemount.searching.best import as_experiment, best_command
from skatemount.searching.study import SharedStudy


@pytest.fixture(autouse=True)
def no_folder_afterwards() -> Iterator[None]:
    yield
    set_user_config_dir(None)


def searched(make_study: Callable[..., SharedStudy]) -> SharedStudy:
    """Return a study with a trial of each kind; the third is the best one."""
    study = make_study(trials=5)
    for number, state in enumerate(("finished", "pruned", "finished", "failed", "")):
        claimed = study.claim()
        assert claimed is not None
        if state == "pruned":
            claimed.trial.report(0.25, 4)
        if state:
            score = None if state == "failed" else Score.of(10 * number, 40, 640, study.folder.path / claimed.job.label)
            study.finish(claimed, state, score, "loss is nan" if state == "failed" else None)
            claimed.job.write_record(score, "loss is nan" if state == "failed" else None, pruned=state == "pruned")
    return study


def test_the_table_and_its_files_have_every_trial(make_study: Callable[..., SharedStudy]) -> None:
    study = searched(make_study)
    records = results.write(study.folder, study)
    folder = study.folder.path
    assert [each["status"] for each in records] == ["finished", "pruned", "finished", "failed", "running"]
    document = json.loads((folder / "results.json").read_text())
    assert document["trials"] == records and document["best"] == records[2]
    assert document["space"] == {"algorithm.epochs": "int(1,8)", "algorithm.target_kl": "log(0.001,0.1)"}
    assert records[2]["low"] < records[2]["success"] == 0.5 < records[2]["high"]
    assert (records[1]["success"], records[1]["low"], records[3]["success"]) == (0.25, None, None)
    rows = list(csv.DictReader((folder / "results.csv").open(encoding="utf-8")))
    assert [row["status"] for row in rows] == [each["status"] for each in records]
    assert float(rows[2]["algorithm.target_kl"]) == records[2]["settings"]["algorithm.target_kl"]
    text = results.report(study.folder, records, study.overrides)
    head, *lines = text.splitlines()
    assert head.split() == ["trial", "epochs", "target_kl", "success", "95", "%", "interval", "steps", "status"]
    assert lines[3].split()[0] == "3" and " 50.0% " in lines[3] and lines[3].endswith("finished")
    assert "trial 4 failed: loss is nan" in lines
    assert "trials that other processes still train: 1; they write the results when they end" in lines
    assert f"best: trial 3, python -m skatemount.evaluate checkpoint={folder}/trial_003" in lines
    # The jobs' records are those that a report of the sweep reads.
    config = compose_program("report", [f"sweep={folder}"])
    group = read_group(config)  # type: ignore[arg-type]
    assert [member.status for member in group.members] == ["finished", "pruned", "finished", "failed"]
    assert group.command.startswith("python -m skatemount.search stage=balance")


def test_without_a_success_there_is_no_best(make_study: Callable[..., SharedStudy]) -> None:
    study = make_study()
    claimed = study.claim()
    assert claimed is not None
    study.finish(claimed, "failed", error="no")
    records = results.write(study.folder, study)
    assert results.report(study.folder, records).endswith("no trial has succeeded")
    assert not (study.folder.path / "best").exists() and not (study.folder.path / "search.png").exists()


def test_zero_is_not_the_best(make_study: Callable[..., SharedStudy]) -> None:
    study = make_study()
    claimed = study.claim()
    assert claimed is not None
    study.finish(claimed, "finished", Score.of(0, 40, 640, study.folder.path / claimed.job.label))
    text = results.report(study.folder, results.write(study.folder, study))
    assert text.endswith("no trial had a success") and "best: " not in text


def test_the_picture_shows_the_trials(make_study: Callable[..., SharedStudy], tmp_path: Path) -> None:
    study = searched(make_study)
    results.write(study.folder, study)
    picture = image.imread(study.folder.path / "search.png")
    assert picture.shape[1] == 1200 and picture.shape[0] == 310
    for color in (results_color("#1f77b4"), results_color("#ff7f0e"), results_color("#d62728")):
        assert (abs(picture[..., :3] - color).max(-1) < 0.02).sum() > 10


def results_color(text: str) -> list[float]:
    return [int(text[i : i + 2], 16) / 255 for i in (1, 3, 5)]


def test_a_training_takes_the_best_settings(make_study: Callable[..., SharedStudy]) -> None:
    overrides = [
        "stage=balance", "total_frames=12345", "experiment=gpu", "physics=cpu", "network.actor=[16,8]", "board=mini",
        "++reward.mounted.weight=2.5", "start.x=[-0.01,0.01]", "init_from=null", "physics.threads=3", "torch_threads=3",
        "stage.description='a, b: c'", "callbacks=[film]",
    ]  # fmt: skip
    study = searched(make_study)
    study.overrides = overrides
    records = results.write(study.folder, study)
    command = shlex.split(best_command(study.folder, overrides))
    assert command[:4] == ["python", "-m", "skatemount.train", "--config-dir"]
    top = records[2]["settings"]
    own = [f"algorithm.target_kl={top['algorithm.target_kl']!r}", f"algorithm.epochs={top['algorithm.epochs']}"]
    machine = ["physics.threads=3", "torch_threads=3"]
    set_user_config_dir(command[4])
    again = compose_program("train", [*command[5:], *machine])
    set_user_config_dir(None)
    asked = compose_program("train", [*overrides, *own])
    assert isinstance(again, TrainConfig) and isinstance(asked, TrainConfig)
    assert to_dict(again) == to_dict(asked) and again.total_frames == 12345


def test_what_a_file_cannot_hold_is_in_the_command(make_study: Callable[..., SharedStudy]) -> None:
    study = searched(make_study)
    assert best_command(study.folder, ["stage=balance", "~reward.alive"]).endswith("experiment=best '~reward.alive'")
    study.folder.config_dir = "my conf"
    copied = best_command(study.folder)
    assert (
        copied.startswith("mkdir -p 'my conf'/experiment && cp ") and "--config-dir 'my conf' experiment=best" in copied
    )


def test_latest_is_the_policy_that_it_meant() -> None:
    made = as_experiment(["stage=balance", "init_from=latest", "board=mini"], {"latest": "runs/a/b/checkpoints/c"})
    assert made == {
        "defaults": [{"override /stage": "balance"}, {"override /board": "mini"}, "_self_"],
        "init_from": "runs/a/b/checkpoints/c",
    }
