"""Ladders: the step at which a rate falls, in words, JSON and a picture."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from skatemount.envs.tasks import TASKS
from skatemount.evaluation import ladder, report
from skatemount.evaluation.intervals import wilson_interval
from skatemount.evaluation.ladder import Ladder, plot_ladders
from skatemount.evaluation.records import EpisodeRecords
from skatemount.evaluation.results import Evaluation

Make = Callable[..., EpisodeRecords]
STEPS = ["0ms", "20ms", "40ms", "60ms"]


def evaluation(
    make_records: Make, successes: list[int], unit: str = "ms", steps: list[str] = STEPS, each: int = 50
) -> Evaluation:
    """Return results of a ladder with a number of successes in each step."""
    n = len(successes)
    success = [turn < successes[i] for turn in range(each) for i in range(n)]
    records = make_records(n * each, success=success, variant=[*range(n)] * each)
    definition = {"version": 1, "ladder": "delay", "unit": unit}
    ends = ["not_mounted"]
    return Evaluation(records, ends, TASKS.get("mount"), variants=steps, evaluated={"definition": definition})


@pytest.mark.parametrize(
    ("successes", "unit", "said", "at"),
    [
        ([50, 48, 44, 46], "ms", "falls below 0.90 at 40ms", "40ms"),
        # Exactly 90 % is not below.
        ([50, 45, 45, 45], "ms", "stays above 0.90", None),
        ([44, 50, 50, 50], "rad", "falls below 0.90 at 0ms rad", "0ms"),
        ([50, 50, 50, 0], "", "falls below 0.90 at 60ms", "60ms"),
    ],
)
def test_it_falls_at_the_first_step_below_90_percent(
    make_records: Make, successes: list[int], unit: str, said: str, at: str | None
) -> None:
    result = evaluation(make_records, successes, unit)
    found = result.ladder()
    assert found is not None and found.verdict == said
    document = json.loads(json.dumps(result.to_dict()["ladder"], allow_nan=False))
    assert (document["falls_below"], document["falls_at"], document["unit"]) == (0.9, at, unit)
    assert [step["rate"] for step in document["steps"]] == [s / 50 for s in successes]
    for step, count in zip(document["steps"], successes, strict=True):
        assert (step["low"], step["high"]) == wilson_interval(count, 50)
    assert Ladder.from_dict(document) == found
    assert report.table(result).splitlines()[-1] == f"delay: success {said}"


def test_several_are_a_table_with_a_row_for_each_step(make_records: Make) -> None:
    first = evaluation(make_records, [50, 48, 44, 46]).ladder()
    second = evaluation(make_records, [50, 47], "m/s", ["0.25", "0.5"]).ladder()
    assert first is not None and second is not None
    lines = ladder.table({"delay": first, "pushed": second}).splitlines()
    assert len(lines) == 2 + 4 + 2
    assert lines[2].split() == "delay 0ms 100.0% 92.9% to 100.0% falls below 0.90 at 40ms".split()
    assert lines[4].split() == "40ms 88.0% 76.2% to 94.4%".split()
    assert lines[6].split() == "pushed 0.25 m/s 100.0% 92.9% to 100.0% stays above 0.90".split()


def test_other_suites_are_none(make_records: Make) -> None:
    result = evaluation(make_records, [50, 48])
    del result.evaluated["definition"]["ladder"]
    assert result.ladder() is None and "ladder" not in result.to_dict() and "0.90" not in report.table(result)
    # A result that an older version wrote, and one without a suite.
    for evaluated in ({"definition": None}, {}):
        result.evaluated = evaluated
        assert result.ladder() is None


def test_fewer_episodes_than_steps_are_a_shorter_ladder(make_records: Make) -> None:
    result = evaluation(make_records, [1, 0], each=1)
    found = result.ladder()
    assert found is not None and [step.name for step in found.steps] == ["0ms", "20ms"]


def test_draws_a_line_for_each_policy(make_records: Make, tmp_path: Path) -> None:
    old, new = (evaluation(make_records, s).ladder() for s in ([40, 20, 10, 0], [50, 49, 48, 47]))
    assert old is not None and new is not None
    colors = []
    for number, policies in enumerate([{"old": old}, {"old": old, "new": new}]):
        path = tmp_path / f"{number}.png"
        plot_ladders({"delay": policies}, path)
        with Image.open(path) as picture:
            pixels = np.asarray(picture.convert("RGB")).reshape(-1, 3).astype(int)
        blue, orange = ((31, 119, 180), (255, 127, 14))
        colors.append([(np.abs(pixels - color) < 20).all(1).sum() > 50 for color in (blue, orange)])
    assert colors == [[True, False], [True, True]]


def test_a_figure_of_five_suites_has_an_empty_place(make_records: Make, tmp_path: Path) -> None:
    each = evaluation(make_records, [50, 40, 30, 20]).ladder()
    assert each is not None
    plot_ladders({f"suite {i}": {"one": each} for i in range(5)}, tmp_path / "a.png")
    with Image.open(tmp_path / "a.png") as picture:
        pixels = np.asarray(picture.convert("L"))
    height, width = pixels.shape
    assert width > 1.5 * height
    places = [pixels[height // 2 :, i * width // 3 + 4 : (i + 1) * width // 3 - 4] for i in range(3)]
    assert [bool((place < 128).any()) for place in places] == [True, True, False]
