"""`benchmarks/runner_pairs.py`: the same episodes in the runner and in `evaluate`."""

from __future__ import annotations

from types import ModuleType

import exported
import pytest
from scripts import load_script

from skatemount.runner.folder import PolicyFolder


@pytest.fixture(scope="module")
def script() -> ModuleType:
    return load_script("benchmarks/runner_pairs.py")


def test_pairs_are_counted_by_their_results(script: ModuleType) -> None:
    def results(successes: str, duration: float = 5.0) -> list:
        return [script.Result(each == "1", "not_mounted", duration, (0.1, 0.2, 0.3)) for each in successes]

    pairs = script.Pairs.of(results("111000000000"), results("101111111100"))
    assert pairs == script.Pairs(both=2, runner=1, evaluate=7, neither=2, other_end=0)
    # 2 (1 + 8) / 2^8
    assert pairs.p_value == pytest.approx(18 / 256)
    assert script.Pairs.of(results("10"), results("10", duration=1.0)).other_end == 2
    assert script.Pairs(runner=3, evaluate=3).p_value == script.Pairs(both=5).p_value == 1.0
    total = pairs + pairs
    assert (total.runner, total.evaluate) == (2, 14)


def test_a_pair_with_two_starts_is_refused(script: ModuleType) -> None:
    one, other = (script.Result(True, "not_mounted", 5.0, (x, 0.0, 0.0)) for x in (0.1, 0.2))
    with pytest.raises(ValueError, match="episode 1 starts at"):
        script.Pairs.of([one, one], [one, other])


@pytest.mark.parametrize("suite", ["stand", "pushed", "sensed", "boards"])
def test_with_the_same_noise_every_episode_ends_alike(script: ModuleType, suite: str) -> None:
    """Of the suites, the first has noise of the observation, the third errors of the sensors, the last two variants."""
    folder, task = PolicyFolder(exported.folder()), exported.suite_task(suite)
    of_torch, of_runner = script.evaluated(task, folder, folder.suites[suite], exported.WORLDS, same_noise=True)
    pairs = script.Pairs.of(of_runner, of_torch)
    assert pairs.both + pairs.neither == exported.WORLDS
    assert pairs.other_end == 0


def test_the_table_has_a_row_of_each_suite(
    script: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(script, "load_suite", lambda name: name)
    monkeypatch.setattr(script.EvaluationTask, "of", lambda agent, suite, *rest: exported.suite_task(suite))
    given = [str(exported.folder()), str(exported.policy_file()), "--suites", "stand", "pushed"]
    monkeypatch.setattr("sys.argv", ["x", *given])
    script.main()
    rows = [line.strip("| ").split(" | ") for line in capsys.readouterr().out.splitlines()]
    assert [row[0] for row in rows] == ["suite", "---|---|---|---|---|---|---|---|---", "`stand`", "`pushed`", "all"]
    assert sum(map(int, rows[-1][3:7])) == 2 * exported.WORLDS


def test_the_folder_must_be_of_the_policy(script: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["x", str(exported.folder()), "pretrained:balance"])
    with pytest.raises(SystemExit, match="is not an export of pretrained:balance"):
        script.main()
