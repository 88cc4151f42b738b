"""The tasks that there are."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from skatemount.config.files import choices, load_file
from skatemount.envs.tasks import TASKS, TaskDefinition
from skatemount.utils.errors import ConfigError


def never(sim: object, episode: object, context: object) -> torch.Tensor:
    """Test for nothing."""
    return torch.zeros(1, dtype=torch.bool)


@pytest.fixture(autouse=True)
def registry() -> Iterator[None]:
    saved = TASKS.snapshot()
    yield
    TASKS.restore(saved)


def test_every_module_and_every_file_of_settings_is_a_task(repo_root: Path) -> None:
    assert choices("task") == TASKS.names()
    for name in TASKS.names():
        # Tasks that judge the same ride in other ways share a module.
        module = "ride" if name.startswith("ride") else name
        assert (repo_root / "skatemount" / "envs" / "tasks" / f"{module}.py").is_file()
        assert load_file("task", name)["success"] == name
        assert TASKS.module(name) == f"skatemount.envs.tasks.{module}"


def test_a_task_is_found_by_its_name() -> None:
    task = TASKS.register(TaskDefinition("wait", "do nothing", never, "moved", "moved"))
    assert TASKS.get("wait") is task and "wait" in TASKS.names()
    assert (TASKS.description("wait"), TASKS.module("wait")) == ("do nothing", __name__)
    TASKS.check()


def test_two_tasks_of_one_name_are_refused() -> None:
    with pytest.raises(ConfigError) as error:
        TASKS.register(TaskDefinition("gait", "walk", never, "fell", "fell"))
    expected = f"task 'gait' is registered twice, by skatemount.envs.tasks.gait and by {__name__}"
    assert str(error.value) == expected


def test_an_unknown_task_is_answered_with_the_nearest() -> None:
    with pytest.raises(ConfigError, match=r"^stage\.x=hodl is not a known task \(did you mean hold\?\); known: gait, "):
        TASKS.get("hodl", "stage.x")
