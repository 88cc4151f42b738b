"""Settings: their schema, composed from YAML and checked."""

from skatemount.config.compose import compose, compose_program, compose_task, from_dict, to_dict
from skatemount.config.files import (
    check_choice,
    config_dir,
    config_dir_options,
    set_user_config_dir,
    stages,
    suites,
    user_config_dir,
    using_config_dir,
)
from skatemount.config.messages import one_line
from skatemount.config.programs import (
    BenchProgramConfig,
    EvaluateConfig,
    PlayConfig,
    PolicyConfig,
    RecordConfig,
    ReportConfig,
    SearchProgramConfig,
)
from skatemount.config.schema import TrainConfig

__all__ = [
    "BenchProgramConfig",
    "TrainConfig",
    "EvaluateConfig",
    "PlayConfig",
    "PolicyConfig",
    "RecordConfig",
    "ReportConfig",
    "SearchProgramConfig",
    "check_choice",
    "compose",
    "compose_program",
    "compose_task",
    "config_dir",
    "config_dir_options",
    "from_dict",
    "one_line",
    "set_user_config_dir",
    "stages",
    "suites",
    "to_dict",
    "user_config_dir",
    "using_config_dir",
]
