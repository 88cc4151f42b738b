"""Sessions of two worlds on one thread, closed at the end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from skatemount.config import compose_program
from skatemount.evaluation.suite_task import EvaluationTask
from skatemount.viewer.session import Session


@pytest.fixture(scope="module")
def make_session() -> Iterator[Callable[..., Session]]:
    """`make(settings of play..., worlds=2)` returns a session of `pretrained:balance`, or of a checkpoint given."""
    made: list[Session] = []

    def make(*settings: str, worlds: int = 2, **arguments: Any) -> Session:
        given = list(settings)
        if not any(each.startswith("checkpoint=") for each in given):
            given.append("checkpoint=pretrained:balance")
        config = compose_program("play", [*given, "physics.threads=1"])
        (task,) = EvaluationTask.prepare(config, given)
        made.append(Session(task, worlds=worlds, **arguments))
        return made[-1]

    yield make
    for session in made:
        session.close()
