"""Settings: their schema, composed from YAML and checked."""

from skatemount.config.compose import compose, compose_task, from_dict, to_dict, to_object
from skatemount.config.files import check_stage, check_suite, config_dir, stages, suites
from skatemount.config.messages import one_line
from skatemount.config.schema import Config

__all__ = [
    "Config",
    "check_stage",
    "check_suite",
    "compose",
    "compose_task",
    "config_dir",
    "from_dict",
    "one_line",
    "stages",
    "suites",
    "to_dict",
    "to_object",
]
