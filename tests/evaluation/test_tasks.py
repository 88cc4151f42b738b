"""A task of one's own is evaluated, shown and logged under its own names, and no other task's are written there."""

from __future__ import annotations

import io
import json
import re
from pathlib import Path
from typing import Any

import pytest
import torch
from rich.console import Console
from torch import Tensor

from skatemount.config import compose
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.tasks import TASKS, Metric, TaskDefinition, TrainingValue
from skatemount.envs.terms import TaskContext
from skatemount.evaluation import report
from skatemount.evaluation.evaluator import Evaluator
from skatemount.evaluation.results import Evaluation
from skatemount.runs.metrics import MetricsFile
from skatemount.training.plots import plot_learning_curves
from skatemount.training.progress import Progress
from skatemount.training.setup import make_networks
from skatemount.utils.errors import ConfigError

SHORT = [
    "network.actor=[8]",
    "network.critic=[8]",
    "episode_length=0.4",
    "physics.threads=1",
    "physics.num_worlds=4",
    "success=be_low",
]


def is_low(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Test whether the trunk is below a meter, ``[N]`` bool."""
    return sim.base_pos[:, 2] < 1.0


def steps(episode: EpisodeState, context: TaskContext) -> Tensor:
    return episode.step


def height(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    return sim.base_pos[:, 2]


STEPS = Metric("steps", "steps done", "steps", lambda sim, episode, context: episode.step, most=lambda _: 10)
BE_LOW = TaskDefinition(
    name="be_low",
    description="keep the trunk low",
    success=is_low,
    failure="too_high",
    failure_words="was too high",
    metrics=(
        Metric("trunk_height", "height of the trunk", "height", height, unit="m", reducer="median"),
        Metric("ever_low", "share of low ones", "low", is_low, reducer="share"),
        Metric("late", "late steps", "steps of failures", STEPS.measure, counts="success", note="each"),
        STEPS,
    ),
    score={"steps": 0.5},
    overview=("trunk_height", "steps"),
    progress=("steps",),
)


def evaluated(task: TaskDefinition = BE_LOW) -> Evaluation:
    """Four episodes of an untrained policy in a task."""
    saved = TASKS.snapshot()
    try:
        TASKS.register(task)
        config = compose("balance", SHORT)
        evaluator = Evaluator(config, 4, seed=1)
    finally:
        TASKS.restore(saved)
    torch.manual_seed(0)
    try:
        return evaluator.run(make_networks(config, evaluator.env.mdp), 4)
    finally:
        evaluator.close()


@pytest.fixture(scope="module")
def result() -> Evaluation:
    return evaluated()


def test_the_results_have_its_names(result: Evaluation) -> None:
    document: dict[str, Any] = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert document.keys() == {
        "episodes", "success", "trunk_height", "ever_low", "late", "steps", "failures", "failed_episodes", "evaluated",
    }  # fmt: skip
    assert document["success"]["rate"] == document["ever_low"] == 1.0
    assert document["steps"] == document["late"] == 10.0
    assert 0.3 < document["trunk_height"]["median"] <= document["trunk_height"]["p95"] < 0.5
    assert document["evaluated"]["task"] == "be_low"
    assert result.end_names[0] == "too_high" and result.in_words("too_high") == "was too high"
    assert result.metrics() == {
        "Evaluation/success": 1.0,
        "Evaluation/trunk_height": document["trunk_height"]["median"],
        "Evaluation/ever_low": 1.0,
        "Evaluation/late": 10.0,
        "Evaluation/steps": 10.0,
    }
    assert result.task.score_of(result.metrics()) == 1.0 + 0.5 * 10.0


def test_the_tables_have_its_labels(result: Evaluation) -> None:
    lines = [line.strip() for line in report.table(result).splitlines()]
    assert any(re.fullmatch(r"height of the trunk +median 0\.\d\d m, 95 % within 0\.\d\d m", line) for line in lines)
    assert any(re.fullmatch(r"share of low ones +100\.0%", line) for line in lines)
    assert any(re.fullmatch(r"late steps +10\.00 each", line) for line in lines)
    assert any(re.fullmatch(r"steps done +10\.00 of 10", line) for line in lines)
    assert "feet" not in report.table(result)
    heading = report.overview({"a": result}, "suite").splitlines()[0]
    assert re.split(r"\s{2,}", heading.strip()) == [
        "suite", "success", "95 % interval", "height of the trunk", "steps done", "main failure",
    ]  # fmt: skip


def test_a_table_of_several_tasks_has_the_columns_of_all(result: Evaluation) -> None:
    other = TaskDefinition("be_high", "x", is_low, "too_low", "was too low")
    second = Evaluation(result.records, ["too_low", *result.end_names[1:]], other)
    rows = report.overview({"second": second, "first": result}, "suite").splitlines()
    assert "steps done" in rows[0]
    (row,) = (line for line in rows if line.strip().startswith("second"))
    assert re.split(r"\s{2,}", row.strip())[-3:] == ["-", "-", "-"]


def test_a_training_shows_its_metric(tmp_path: Path) -> None:
    shown = [Metric("steps", "steps done", "steps", height, training=TrainingValue(steps), most=lambda _: 10)]
    out = io.StringIO()
    with Progress(100, "x", console=Console(file=out), metrics=shown) as progress:
        progress.log({"Evaluation/steps": 3.0}, 10)
    assert "steps done 3.00" in out.getvalue()
    with Progress(100, "x", console=Console(file=out), metrics=shown) as progress:
        progress.log({"Evaluation/steps": 3.0, "Success/steps": 4.0}, 20)
    assert "steps done 4.00" in out.getvalue()
    table = MetricsFile(tmp_path / "m.jsonl")
    for i in range(1, 4):
        table.log({"Success/steps": float(i), "Loss/kl": 0.1}, 1000 * i)
    table.close()
    from matplotlib.image import imread

    sizes = []
    for number in range(4):
        plot_learning_curves(tmp_path / "m.jsonl", tmp_path / "m.png", metrics=shown * number)
        sizes.append(imread(tmp_path / "m.png").shape[1] // 440)
    assert sizes == [3, 3, 4, 4]  # columns


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        (
            {"success": lambda *_: torch.zeros(1)},
            "task 'be_low': success returned float32 of shape [1]; it must return",
        ),
        (
            {"metrics": (Metric("pose", "pose", "pose", lambda sim, *_: sim.base_pos),), "score": {}},
            "task 'be_low', metric 'pose' returned float32 of shape [5, 3]; it must return one value a world of shape "
            "[5]",
        ),
    ],
)
def test_what_returns_something_else_is_named(fields: dict[str, Any], said: str) -> None:
    wrong = TaskDefinition(**vars(BE_LOW) | {"overview": (), "progress": ()} | fields)
    with pytest.raises(ConfigError) as error:
        evaluated(wrong)
    assert str(error.value).startswith(said) and "\n" not in str(error.value)


def test_no_task_is_named_where_results_are_made(repo_root: Path) -> None:
    folder = repo_root / "skatemount"
    files = [
        *(folder / "evaluation").glob("*.py"),
        *(folder / "training" / name for name in ("plots.py", "progress.py")),
    ]
    assert len(files) > 8
    for path in files:
        text = re.sub(r"skatemount|MountEnv|MountTask|MountBench|envs\.mount_env", "", path.read_text(encoding="utf-8"))
        assert not re.findall(r"\w*mount\w*|\bgait\b|\bhold\b|\bfeet\b", text, re.IGNORECASE), path
