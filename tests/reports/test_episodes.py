"""Best and worst episodes, and films of them in a page."""

from __future__ import annotations

import base64
import math
import os
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest
import torch
from parsed_page import Page

from skatemount.config import compose_program
from skatemount.envs.tasks import TASKS
from skatemount.evaluation.records import EpisodeRecords
from skatemount.evaluation.results import Evaluation
from skatemount.report import report
from skatemount.reports.episodes import Evaluated, Film, chosen_episodes, films_of_run, fitting, ranked, task_overrides

needs_opengl = pytest.mark.skipif(
    os.environ.get("MUJOCO_GL") not in ("egl", "osmesa"), reason="needs OpenGL without a display"
)


def evaluation(success: list[bool], feet: list[float], time: list[float], duration: list[float]) -> Evaluation:
    n = len(success)
    nothing = torch.zeros(n)
    records = EpisodeRecords(
        number=10 + torch.arange(n),
        variant=torch.zeros(n, dtype=torch.int64),
        start=torch.zeros(n, 3),
        board_fixed=torch.zeros(n, dtype=torch.bool),
        success=torch.tensor(success),
        end=torch.tensor([0 if each else 1 for each in success]),
        duration=torch.tensor(duration),
        metrics={"time_to_mount": torch.tensor(time), "feet_on_board": torch.tensor(feet),
                 "board_displacement": nothing, "slips": nothing, "energy": nothing},
    )  # fmt: skip
    return Evaluation(records, ["not_mounted", "tilt"], TASKS.get("mount"))


def test_the_order_of_episodes() -> None:
    nan = math.nan
    found = evaluation(
        success=[False, True, True, True, False],
        feet=[0.0, 4.0, 4.0, 3.9, 0.0],
        time=[nan, 2.0, 1.0, 0.5, nan],
        duration=[1.0, 6.0, 6.0, 6.0, 3.0],
    )
    # Feet count most, then the time; a failure is the worse the sooner it ended.
    assert ranked(found) == [2, 1, 3, 4, 0]


def test_best_of_the_first_suite_and_worst_of_the_worst() -> None:
    good = evaluation([True, True], [4.0, 4.0], [2.0, 1.0], [6.0, 6.0])
    bad = evaluation([False, True], [0.0, 4.0], [math.nan, 1.0], [1.0, 6.0])
    first, second = (cast(Evaluated, SimpleNamespace(evaluation=each)) for each in (good, bad))
    assert chosen_episodes([first, second], 1) == [(first, 11, "best"), (second, 10, "worst")]
    # One suite with as many episodes as films: no episode is filmed twice.
    assert [number for _, number, _ in chosen_episodes([first], 1)] == [11, 10]
    assert [number for _, number, _ in chosen_episodes([first], 2)] == [11, 10]
    assert chosen_episodes([first], 0) == [] and chosen_episodes([], 3) == []


def test_films_fit_into_their_size() -> None:
    films = [Film(name, "", bytes(size), "best") for name, size in (("a", 300_000), ("b", 900_000), ("c", 300_000))]
    kept, left = fitting(films, 1.0)
    assert [film.title for film in kept] == ["a", "c"] and left == ["b"]


def test_films_in_the_runs_folder(tmp_path: Path) -> None:
    assert films_of_run(None) == [] and films_of_run(tmp_path) == []
    (tmp_path / "videos").mkdir()
    for age, name in enumerate(("new_one", "old")):
        (tmp_path / "videos" / f"{name}.mp4").write_bytes(b"film")
        os.utime(tmp_path / "videos" / f"{name}.mp4", (1000 - age, 1000 - age))
    assert [film.title for film in films_of_run(tmp_path)] == ["new one", "old"]


def test_settings_of_the_task_are_the_evaluations() -> None:
    given = ["run=latest", "page.films=0", "board=longboard", "start.x=[0,1]", "seed=3", "logger.root=r"]
    assert task_overrides(given) == ["board=longboard", "start.x=[0,1]"]


@pytest.mark.slow
@needs_opengl
def test_a_page_with_evaluation_map_and_films(first: Path, tmp_path: Path) -> None:
    given = [
        f"run={first}", "page.suites=[own]", "page.episodes=3", "page.film_width=160", "episode_length=0.12",
        "physics.num_worlds=4", "physics.threads=1", f"output={tmp_path / 'r.html'}",
    ]  # fmt: skip
    report(compose_program("report", given), given)
    page = Page((tmp_path / "r.html").read_text(encoding="utf-8"))
    page.check_whole()
    videos = [value for tag, name, value in page.addresses if tag == "video" and name == "src"]
    (picture,) = (value for tag, _, value in page.addresses if tag == "img" and "png" in value[:20])
    assert len(videos) == 2 and base64.b64decode(picture.partition(",")[2])[:4] == b"\x89PNG"
    posters = [value for _, name, value in page.addresses if name == "poster"]
    assert [value.startswith("data:image/jpeg;base64,/9j/") for value in posters] == [True, True]
    for video in videos:
        kind, _, data = video.partition(",")
        assert kind == "data:video/mp4;base64" and base64.b64decode(data)[4:8] == b"ftyp"
    assert "episode_length=0.12" in page.sections["episodes"] and "3 episodes" in page.sections["suites"]
    assert "balance (evaluated for this page), changed by episode_length=0.12" in page.sections["suites"]
