"""Pruning: success is reported at fixed points of a training, and hopeless trials end early."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import pytest

from skatemount.runs.sweep import Score
from skatemount.searching.pruning import PruningCallback, TakenOver, success_of
from skatemount.searching.study import POINTS, Claimed, SharedStudy


class FakeTrainer:
    """The attributes and methods of a trainer that the callback uses."""

    def __init__(self, total: int = 1000, evaluates: bool = True) -> None:
        logger = SimpleNamespace(evaluate_every=int(evaluates), final_episodes=7)
        self.config = SimpleNamespace(logger=logger, total_frames=total)
        self.frames = self.saved_frames = 0
        self.stopped = False

    @property
    def stopping(self) -> bool:
        return self.stopped or self.frames >= self.config.total_frames

    def stop(self) -> None:
        self.stopped = True


def train(study: SharedStudy, values: Sequence[float | None], **named: Any) -> tuple[Claimed, PruningCallback, int]:
    """Train a trial whose evaluations give these values, one an iteration; return how many it took."""
    claimed = study.claim()
    assert claimed is not None
    callback, trainer = PruningCallback(claimed), FakeTrainer(**named)
    done = 0
    for value in values:
        trainer.frames += trainer.config.total_frames // len(values)
        key = "Evaluation/success" if trainer.config.logger.evaluate_every else "Success/rate"
        callback.on_iteration_end(trainer, {} if value is None else {key: value})  # type: ignore[arg-type]
        done += 1
        if trainer.stopping:
            break
    callback.on_train_end(trainer)  # type: ignore[arg-type]
    assert trainer.config.logger.final_episodes == (0 if callback.pruned else 7)
    study.finish(
        claimed, "pruned" if callback.pruned else "finished", Score.of(round(100 * (values[done - 1] or 0)), 100)
    )
    return claimed, callback, done


def reported(study: SharedStudy, number: int) -> dict[int, float]:
    return dict(study.trials()[number].intermediate_values)


def test_a_hopeless_trial_is_pruned_and_a_good_one_is_not(make_study: Callable[..., SharedStudy]) -> None:
    study = make_study(prune_startup=2, prune_after=0.5)
    assert [train(study, values)[2] for values in ([0.1, 0.5, 0.6, 0.8], [0.2, 0.4, 0.5, 0.7])] == [4, 4]
    # At the half it is below the median of the others there, 0.45.
    _, callback, done = train(study, [0.0, 0.3, 0.4, 0.9])
    assert callback.pruned and done == 2
    assert [train(study, [0.0, 0.46, 0.9, 0.9])[2]] == [4]


def test_nothing_is_pruned_before_its_time(make_study: Callable[..., SharedStudy]) -> None:
    study = make_study(prune_startup=2, prune_after=0.75)
    train(study, [0.9] * 4)
    assert train(study, [0.0] * 4)[2] == 4  # only one other has finished
    assert train(study, [0.0] * 4)[2] == 3


def test_without_a_pruner_no_trial_ends_early(make_study: Callable[..., SharedStudy]) -> None:
    study = make_study(pruner="none")
    train(study, [0.9] * 4)
    assert train(study, [0.0] * 4)[2] == 4


def test_points_between_evaluations_have_the_last_value(make_study: Callable[..., SharedStudy]) -> None:
    study = make_study(pruner="none")
    train(study, [None, 0.5, None, 0.75])
    quarter = POINTS // 4
    assert reported(study, 0) == {
        **dict.fromkeys(range(2 * quarter, 4 * quarter), 0.5),
        4 * quarter: 0.75,
    }


def test_success_is_that_of_the_evaluations_or_of_the_training() -> None:
    metrics = {"Evaluation/success": 0.5, "Success/rate": 0.25}
    assert success_of(metrics, True) == 0.5 and success_of(metrics, False) == 0.25
    assert success_of({"Success/rate": 0.25}, True) != 0.25  # not a number


def test_a_training_that_resumes_reports_what_is_new(make_study: Callable[..., SharedStudy]) -> None:
    study = make_study(pruner="none")
    claimed = study.claim()
    assert claimed is not None
    trainer = FakeTrainer(evaluates=False)
    first = PruningCallback(claimed)
    for frames, value in ((250, 0.1), (500, 0.2)):
        trainer.frames = frames
        first.on_iteration_end(trainer, {"Success/rate": value})  # type: ignore[arg-type]
    again = PruningCallback(claimed)
    for frames, value in ((250, 0.9), (500, 0.9), (750, 0.3)):
        trainer.frames = frames
        again.on_iteration_end(trainer, {"Success/rate": value})  # type: ignore[arg-type]
    values = reported(study, 0)
    assert values[POINTS // 4] == 0.1 and values[POINTS // 2] == 0.2 and values[3 * POINTS // 4] == 0.3


def test_a_process_that_has_lost_its_trial_saves_nothing_more(make_study: Callable[..., SharedStudy]) -> None:
    study = make_study()
    claimed = study.claim()
    assert claimed is not None
    callback, trainer = PruningCallback(claimed), FakeTrainer()
    study.folder.sign(1).take()
    trainer.frames = 250
    with pytest.raises(TakenOver):
        callback.on_iteration_end(trainer, {})  # type: ignore[arg-type]
    assert trainer.saved_frames == 250
