from __future__ import annotations

import exported
import pytest

from skatemount.evaluation import intervals
from skatemount.runner.bench import document, run_suite, wilson_interval
from skatemount.runner.folder import PolicyFolder, RunnerError


@pytest.fixture(scope="module")
def folder() -> PolicyFolder:
    return PolicyFolder(exported.folder())


def test_results_have_the_keys_of_an_evaluation(folder: PolicyFolder) -> None:
    results = run_suite(folder, "boards")
    assert [result.episode for result in results] == [0, 1, 2, 3]
    assert [result.variant for result in results] == ["usual", "long", "usual", "long"]
    made = document(folder, "boards", results, seed=0)
    theirs = exported.suite_task("boards").evaluate(4).to_dict()
    assert made["episodes"] == theirs["episodes"] and made["success"].keys() == theirs["success"].keys()
    assert made["variants"].keys() == theirs["variants"].keys()
    assert sum(made["failures"].values()) == len(made["failed_episodes"])
    ours = {each["episode"]: each for each in made["failed_episodes"]}
    # The episodes are the same ones: where both failed, they began alike.
    both = [each for each in theirs["failed_episodes"] if each["episode"] in ours]
    assert both
    for each in both:
        assert each["start"] == pytest.approx(ours[each["episode"]]["start"], abs=1e-3)
        assert each.keys() == ours[each["episode"]].keys()


def test_without_noise_episodes_end_as_in_the_evaluation(folder: PolicyFolder) -> None:
    # The sensed suite has noise, the others differ from the evaluation by that of the terms alone.
    theirs = exported.suite_task("stand").evaluate(exported.WORLDS)
    ours = run_suite(folder, "stand")
    assert sum(result.success for result in ours) == theirs.successes


@pytest.mark.parametrize(
    ("suite", "episodes", "expected"),
    [
        ("far", None, "suite=far: the folder has stand, pushed, sensed, walk, boards; export with suite=far"),
        ("stand", 5, "episodes=5 must be from 1 to 4, the start states of stand in the folder"),
        ("stand", 0, "episodes=0 must be from 1 to 4"),
    ],
)
def test_what_is_not_in_the_folder(folder: PolicyFolder, suite: str, episodes: int | None, expected: str) -> None:
    with pytest.raises(RunnerError) as error:
        run_suite(folder, suite, episodes)
    assert str(error.value).startswith(expected)


@pytest.mark.parametrize(("successes", "trials"), [(0, 10), (10, 10), (3, 7), (986, 1000)])
def test_the_interval_is_that_of_evaluations(successes: int, trials: int) -> None:
    assert wilson_interval(successes, trials) == pytest.approx(intervals.wilson_interval(successes, trials))
