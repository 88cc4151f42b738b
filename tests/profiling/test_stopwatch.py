"""The stopwatch: who spent how long, and that nothing is left behind."""

from __future__ import annotations

from pathlib import Path

import pytest
from tiny import SILENT, TINY

from skatemount.config import compose
from skatemount.profiling.stopwatch import COLLECTING, LEARNING, Stopwatch, profile_trainer
from skatemount.training.trainer import Trainer


class Clock:
    """Stands still but for what a worker says that it takes."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


class Worker:
    def __init__(self, clock: Clock):
        self.clock = clock

    def outer(self) -> str:
        self.clock.now += 2.0
        result = self.inner()
        self.clock.now += 1.0
        return result

    def inner(self) -> str:
        self.clock.now += 5.0
        return "done"


def test_a_part_does_not_count_what_is_timed_inside_it() -> None:
    worker = Worker(Clock())
    stopwatch = Stopwatch(worker.clock)
    stopwatch.time(worker, "outer", "outer")
    stopwatch.time(worker, "inner", "inner")
    assert worker.outer() == "done"
    assert stopwatch.spent == {"outer": 3.0, "inner": 5.0}


def test_a_whole_part_counts_what_is_timed_inside_it() -> None:
    worker = Worker(Clock())
    stopwatch = Stopwatch(worker.clock)
    stopwatch.time(worker, "outer", "outer", whole=True)
    stopwatch.time(worker, "inner", "inner")
    worker.outer()
    assert stopwatch.spent == {"outer": 8.0}
    worker.inner()
    assert stopwatch.spent == {"outer": 8.0, "inner": 5.0}


def test_the_attribute_is_put_back_after_an_error() -> None:
    clock = Clock()

    class Fails:
        def work(self) -> None:
            clock.now += 1.0
            raise ValueError("as it must")

    worker, stopwatch = Fails(), Stopwatch(clock)
    put_back = stopwatch.time(worker, "work", "work")
    with pytest.raises(ValueError, match="as it must"):
        worker.work()
    assert stopwatch.spent == {"work": 1.0}
    put_back()
    assert "work" not in vars(worker)


def test_every_part_of_a_training_is_timed_and_left_as_it_was(tmp_path: Path) -> None:
    trainer = Trainer(compose("balance", [*TINY, *SILENT, "init_from=null", f"logger.root={tmp_path}"]))
    iterations = trainer.iterations()
    watched = [(trainer.env.physics, "step"), (trainer.env.mdp, "observation"), (trainer.algorithm, "_step")]
    before = [getattr(owner, name) for owner, name in watched]
    with profile_trainer(trainer) as stopwatch:
        while "reset" not in stopwatch.spent or "update" not in stopwatch.spent:
            next(iterations)
    assert set(stopwatch.spent) == {*COLLECTING, *LEARNING}
    assert [getattr(owner, name) for owner, name in watched] == before
    spent = dict(stopwatch.spent)
    next(iterations)
    assert stopwatch.spent == spent
    iterations.close()
    trainer.close()
