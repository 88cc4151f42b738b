"""Evaluate a policy for a page, choose its best and worst episodes, and film them."""

from __future__ import annotations

import io
import math
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from PIL import Image

from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.config import ReportConfig
from skatemount.config.report import OWN
from skatemount.envs.boards import boards_of
from skatemount.envs.config.task import TaskConfig
from skatemount.evaluation.results import Evaluation
from skatemount.evaluation.success_map import plot_success_map
from skatemount.evaluation.suite_task import EvaluationTask, load_suite, members_of
from skatemount.reports.suites import FOR_PAGE, Result, parse
from skatemount.runs.provenance import package_versions
from skatemount.utils.cores import available_cores

MAX_RATE = 30.0
"""Pictures a second of a film; of a faster control rate only every so many steps are shown."""


@dataclass
class Evaluated:
    """An evaluation made for a page.

    Attributes:
        task: The policy and its test.
        evaluation: The episodes.
        result: The same for tables.
        success_map: The picture of success over the start pose, PNG.
    """

    task: EvaluationTask
    evaluation: Evaluation
    result: Result
    success_map: bytes


@dataclass
class Film:
    """A film in a page.

    Attributes:
        title: What it shows.
        caption: What became of the episode, and how to repeat it.
        data: The MP4; empty if there is no film.
        kind: ``best``, ``worst`` or ``run`` (a film that lay in the run's folder).
        command: Command that films it again.
        poster: Picture that stands for it until it is played, JPEG; empty for none.
    """

    title: str
    caption: str
    data: bytes
    kind: str
    command: str = ""
    poster: bytes = b""


def evaluate(
    spec: str, config: ReportConfig, suites: Sequence[str], overrides: Sequence[str], say: Callable[[str], None]
) -> list[Evaluated]:
    """Evaluate a policy in suites.

    Args:
        spec: The policy.
        config: Settings of the program.
        suites: Names of suites, or `OWN`.
        overrides: The user's overrides of the task's settings.
        say: Called with what is done.

    Raises:
        ConfigError: The policy does not fit a suite.
    """
    agent = TrainedPolicy.load(spec, config.logger.root, "run")
    chosen = [each for name in suites for each in ([None] if name == OWN else members_of(load_suite(name)))]
    found = []
    for suite in chosen:
        task = EvaluationTask.of(agent, suite, overrides, config.seed)
        task.torch_threads = config.torch_threads or available_cores()
        say(f"evaluating {task.title}, {config.page.episodes} episodes")
        evaluation = task.evaluate(config.page.episodes)
        evaluation.evaluated["versions"] = package_versions()
        document = evaluation.to_dict()
        document["evaluated"]["suite"] = task.name if suite is not None else f"{task.name} ({FOR_PAGE})"
        (result,) = parse(document, f"{config.page.episodes} episodes, seed {config.seed}, evaluated for this page")
        found.append(Evaluated(task, evaluation, result, _map(task, evaluation)))
    return found


def prepared(spec: str, suite: str, config: ReportConfig) -> EvaluationTask:
    """Return a policy and its test.

    Args:
        spec: The policy.
        suite: Name of a suite without members.
        config: Settings of the program.
    """
    task = EvaluationTask.of(TrainedPolicy.load(spec, config.logger.root, "run"), load_suite(suite), seed=config.seed)
    task.torch_threads = config.torch_threads or available_cores()
    return task


def ranked(evaluation: Evaluation) -> list[int]:
    """Return the rows of all episodes, the best first.

    Successes come before failures. Within both, the task's score decides (`TaskDefinition.score`), then the task's
    first metric with its best value first: less time for a success, more time before it ended for a failure.

    Args:
        evaluation: The evaluation.
    """
    records, task = evaluation.records, evaluation.task
    score = torch.zeros(len(records), dtype=torch.float64)
    for name, weight in task.score.items():
        score += weight * records.metrics[name].double().nan_to_num(0.0)
    time = records.metrics.get("time_to_mount", torch.zeros(len(records))).double().nan_to_num(math.inf)
    order = [
        (not success, -round(points, 9), seconds if success else -duration, number)
        for success, points, seconds, duration, number in zip(
            records.success.tolist(), score.tolist(), time.tolist(), records.duration.tolist(), records.number.tolist()
        )
    ]
    return sorted(range(len(order)), key=lambda row: order[row])


def chosen_episodes(evaluated: Sequence[Evaluated], count: int) -> list[tuple[Evaluated, int, str]]:
    """Choose the episodes to film: the best ones of the first suite, and the worst ones of the suite that went worst.

    Args:
        evaluated: The evaluations.
        count: Number of best and of worst episodes.

    Returns:
        Evaluation, number of the episode, and ``best`` or ``worst``.
    """
    if not evaluated or not count:
        return []
    first, worst = evaluated[0], min(evaluated, key=lambda each: each.evaluation.success_rate)
    best_rows = ranked(first.evaluation)[:count]
    worst_rows = [row for row in ranked(worst.evaluation)[::-1] if worst is not first or row not in best_rows][:count]
    return [(first, int(first.evaluation.records.number[row]), "best") for row in best_rows] + [
        (worst, int(worst.evaluation.records.number[row]), "worst") for row in worst_rows
    ]


def film(evaluated: Evaluated, number: int, kind: str, width: int) -> Film:
    """Film an episode.

    Args:
        evaluated: Its evaluation.
        number: Its number.
        kind: ``best`` or ``worst``.
        width: Pixels; the height is three quarters of it.

    Raises:
        ConfigError: There is no OpenGL, or no ffmpeg.
    """
    from skatemount.rendering.film import default_film, write_film
    from skatemount.rendering.playback import replay_episodes

    (episode,) = replay_episodes(evaluated.task, [number])
    settings = default_film(width=width, height=width * 3 // 4, caption=False)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "film.mp4"
        picture = write_film([episode], settings, "", file, max_rate=MAX_RATE)
        data = file.read_bytes()
    return Film(
        title=f"{evaluated.result.name}, episode {number}",
        caption=episode.summary,
        data=data,
        kind=kind,
        command=evaluated.task.record_command(number),
        poster=_jpeg(picture),
    )


def six_moments(task: EvaluationTask, width: int = 480) -> tuple[str, bytes]:
    """Return what the strip of an episode's six moments shows, and the strip as JPEG.

    Args:
        task: The policy and its test; its first success is shown.
        width: Pixels of one picture.

    Raises:
        ConfigError: There is no OpenGL.
    """
    from skatemount.rendering.film import default_film, moments_sheet
    from skatemount.rendering.search import first_success

    episode = first_success(task)
    caption = f"{task.title}, episode {episode.number}: {episode.summary}"
    return caption, _jpeg(moments_sheet([episode], default_film(caption=False), "", width))


def films_of_run(folder: Path | None) -> list[Film]:
    """Return the films that lie in a run's folder, the newest first."""
    if folder is None or not (folder / "videos").is_dir():
        return []
    files = sorted((folder / "videos").glob("*.mp4"), key=lambda file: file.stat().st_mtime, reverse=True)
    return [Film(file.stem.replace("_", " "), "in the run's folder", file.read_bytes(), "run") for file in files]


def fitting(films: Sequence[Film], megabytes: float) -> tuple[list[Film], list[str]]:
    """Return the films that fit into a size, in their order, and the titles of the others.

    Args:
        films: The films, the most important first.
        megabytes: Size of all of them together in the page, where they are a third larger.
    """
    room, kept, left = megabytes * 1e6, [], []
    for each in films:
        size = (len(each.data) + len(each.poster)) * 4 / 3
        if size <= room:
            kept.append(each)
            room -= size
        else:
            left.append(each.title)
    return kept, left


def task_overrides(overrides: Sequence[str]) -> list[str]:
    """Return those of a command line's overrides that are of the task, not of this program."""
    from skatemount.config.keys import keys
    from skatemount.runs.sweep import key_of

    return [each for each in overrides if key_of(each).partition(".")[0] in {*keys(TaskConfig), "task"}]


def _jpeg(picture: Image.Image) -> bytes:
    file = io.BytesIO()
    picture.convert("RGB").save(file, format="jpeg", quality=85)
    return file.getvalue()


def _map(task: EvaluationTask, evaluation: Evaluation) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.png"
        boards = [board for config in task.configs.values() for board in boards_of(config.boards, config.board)]
        plot_success_map(evaluation, boards, path)
        return path.read_bytes()
