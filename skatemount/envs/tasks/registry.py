"""`TASKS`: the tasks that there are, by name."""

from __future__ import annotations

import difflib

from skatemount.envs.tasks.definition import TaskDefinition
from skatemount.utils.errors import ConfigError


class TaskRegistry:
    """Task definitions by name."""

    def __init__(self) -> None:
        self._tasks: dict[str, TaskDefinition] = {}
        self._modules: dict[str, str] = {}

    def register(self, task: TaskDefinition) -> TaskDefinition:
        """Add a task, and return it.

        Args:
            task: The task.

        Raises:
            ConfigError: The name is taken.
        """
        module = task.success.__module__
        if task.name in self._tasks:
            raise ConfigError(f"task {task.name!r} is registered twice, by {self._modules[task.name]} and by {module}")
        self._tasks[task.name], self._modules[task.name] = task, module
        return task

    def get(self, name: str, where: str = "success") -> TaskDefinition:
        """Return a task.

        Args:
            name: Its name.
            where: Name of the setting, for messages.

        Raises:
            ConfigError: There is no such task.
        """
        if name not in self._tasks:
            close = difflib.get_close_matches(name, self._tasks, n=1)
            hint = f" (did you mean {close[0]}?)" if close else ""
            own = "" if close else "; one of your own needs plugins=[<module>]"
            raise ConfigError(f"{where}={name} is not a known task{hint}; known: {', '.join(self.names())}{own}")
        return self._tasks[name]

    def names(self) -> list[str]:
        """Return every known name, sorted."""
        return sorted(self._tasks)

    def description(self, name: str) -> str:
        """Return the line about a task."""
        return self._tasks[name].description

    def module(self, name: str) -> str:
        """Return the name of the module that registered a task."""
        return self._modules[name]

    def snapshot(self) -> tuple[dict[str, TaskDefinition], dict[str, str]]:
        """Return the present tasks, for `restore`."""
        return dict(self._tasks), dict(self._modules)

    def restore(self, saved: tuple[dict[str, TaskDefinition], dict[str, str]]) -> None:
        """Go back to the tasks of a snapshot."""
        self._tasks, self._modules = dict(saved[0]), dict(saved[1])

    def check(self) -> None:
        """Do nothing: a definition checks itself when it is made."""


TASKS = TaskRegistry()
"""The tasks of the package and of imported plugins."""
