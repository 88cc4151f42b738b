"""Tasks: what an episode is about. Each module that defines a task registers it in `TASKS`."""

import importlib
import pkgutil

from skatemount.envs.tasks.definition import Metric, TaskDefinition, TrainingValue
from skatemount.envs.tasks.measures import Measure, integral
from skatemount.envs.tasks.registry import TASKS

__all__ = ["TASKS", "Measure", "Metric", "TaskDefinition", "TrainingValue", "integral"]

# A new task is one new module, so none is named here.
for _module in pkgutil.iter_modules(__path__):
    importlib.import_module(f"{__name__}.{_module.name}")
