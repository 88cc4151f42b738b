"""Tests of a shipped policy in few worlds, as `python -m skatemount.record` prepares them."""

from __future__ import annotations

from skatemount.config import compose_program
from skatemount.evaluation.suite_task import EvaluationTask


def filmed(suite: str, *overrides: str, policy: str = "best", worlds: int = 6) -> EvaluationTask:
    settings = [f"checkpoint=pretrained:{policy}", f"suite={suite}", f"physics.num_worlds={worlds}"]
    settings += ["physics.threads=1", *overrides]
    (found,) = EvaluationTask.prepare(compose_program("record", settings), settings)
    return found
