"""Study of a search: processes share the trials, each trial once, and take over those of dead processes."""

from __future__ import annotations

import json
from collections.abc import Callable

import pytest

from skatemount.runs.sweep import Score
from skatemount.searching import study as study_module
from skatemount.searching.results import records_of
from skatemount.searching.study import SharedStudy, check_installed
from skatemount.utils.errors import ConfigError


def test_processes_share_the_trials(make_study: Callable[..., SharedStudy]) -> None:
    first, second = make_study(), make_study()
    claimed = [study.claim() for study in (first, second, first, second)]
    assert first.claim() is None and second.claim() is None
    assert all(claimed)
    trials = [each for each in claimed if each is not None]
    assert [each.job.number for each in trials] == [1, 2, 3, 4]
    assert len({each.params["algorithm.target_kl"] for each in trials}) == 4
    assert trials[1].job.label == "trial_002"
    assert trials[1].job.describe().startswith("trial 2 of 4: algorithm.epochs=")
    assert trials[1].job.overrides[0] == "stage=balance" and len(trials[1].job.overrides) == 3
    for number, each in enumerate(trials):
        assert (first, second)[number % 2].finish(each, "finished", Score.of(number, 10, 100, None))
    assert [record["success"] for record in records_of(first)] == [0.0, 0.1, 0.2, 0.3]
    # More trials go on with the search.
    third = make_study(trials=5).claim()
    assert third is not None and third.job.number == 5 and not third.taken_over


def test_a_trial_of_a_dead_process_is_taken_over_with_its_values(make_study: Callable[..., SharedStudy]) -> None:
    first, second = make_study(), make_study()
    lost = first.claim()
    assert lost is not None
    assert records_of(second)[0]["status"] == "running"
    owner = json.loads(lost.sign.path.read_text())
    lost.sign.path.write_text(json.dumps(owner | {"process": 2**22 + 1}))
    assert records_of(second)[0]["status"] == "stopped"
    taken = second.claim()
    assert taken is not None and taken.taken_over
    assert (taken.job.number, taken.params) == (1, lost.params) and taken.job.overrides == lost.job.overrides
    # What the slow process brings later does not count.
    assert not first.finish(lost, "finished", Score.of(9, 10))
    assert second.finish(taken, "finished", Score.of(1, 10))
    assert not second.finish(taken, "finished", Score.of(2, 10))
    assert [record["success"] for record in records_of(first)] == [0.1]


def test_a_search_goes_on_as_if_it_had_not_been_stopped(make_study: Callable[..., SharedStudy]) -> None:
    def values(study: SharedStudy, number: int) -> list[object]:
        found = []
        for _ in range(number):
            claimed = study.claim()
            assert claimed is not None
            found.append(claimed.params["algorithm.target_kl"])
            study.finish(claimed, "finished", Score.of(claimed.job.number, 100))
        return found

    changed = {"trials": 5, "random_trials": 2}
    whole = values(make_study("whole", **changed), 5)
    parts = values(make_study("parts", **changed), 3) + values(make_study("parts", **changed), 2)
    assert whole == parts and len(set(whole)) == 5
    assert values(make_study("other", **changed, seed=1), 5)[0] != whole[0]


def test_failed_and_pruned_trials_count(make_study: Callable[..., SharedStudy]) -> None:
    study = make_study(trials=2)
    failed, pruned = study.claim(), study.claim()
    assert failed is not None and pruned is not None and study.claim() is None
    study.finish(failed, "failed", error="loss is nan")
    pruned.trial.report(0.25, 4)
    study.finish(pruned, "pruned", Score.of(0, 0, 64))
    records = records_of(make_study(trials=2))
    assert [(each["status"], each["success"], each["error"], each["steps"]) for each in records] == [
        ("failed", None, "loss is nan", None),
        ("pruned", 0.25, None, 64),
    ]


def test_a_line_that_was_cut_off_is_dropped(make_study: Callable[..., SharedStudy]) -> None:
    study = make_study()
    claimed = study.claim()
    assert claimed is not None
    study.finish(claimed, "finished", Score.of(1, 2))
    journal = study.folder.path / "journal.log"
    whole = journal.read_bytes()
    journal.write_bytes(whole + b'{"op_code":4,"wor')
    again = make_study()
    assert journal.read_bytes().startswith(whole) and records_of(again)[0]["success"] == 0.5
    assert again.claim() is not None and len(records_of(make_study())) == 2


def test_a_missing_package_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study_module.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"needs the package optuna: pip install 'skatemount\[sweep\]'$"):
        check_installed()
