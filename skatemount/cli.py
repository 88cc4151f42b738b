"""How every `python -m skatemount.<verb>` starts: Hydra composes the settings, errors are one line."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from skatemount import config as configuration
from skatemount.config import Config
from skatemount.config.versions import rename_override
from skatemount.utils.errors import ConfigError
from skatemount.utils.quiet import ignore_torchrl_warnings

_BELONGS_TO = {
    **dict.fromkeys(("init_from", "init_from_expand", "total_frames", "precision"), ("train", "bench")),
    **dict.fromkeys(("algorithm", "collector", "curriculum"), ("train", "bench")),
    **dict.fromkeys(("resume", "torch_threads"), ("train",)),
    **dict.fromkeys(("checkpoint", "pipeline", "switch_distance", "suite"), ("evaluate", "record")),
    "output": ("evaluate", "record", "bench"),
    "episodes": ("evaluate",),
    "json": ("evaluate", "bench"),
    "episode": ("record",),
    "bench": ("bench",),
}
"""Settings, or groups of them, that other programs do not look at."""

_INSTEAD = {
    ("train", "checkpoint"): "training starts from init_from=<policy>, or goes on with resume=<run>",
    ("record", "episodes"): "episode=<number> says which one to film",
    ("evaluate", "episode"): "episodes=<number> says how many to evaluate",
}


def run(verb: Callable[[Config, list[str]], None], name: str) -> None:
    """Compose the settings from the command line and run a verb on them; `-m` runs it once a combination.

    A mistake in the settings ends the program with one line and status 2; ``SKATEMOUNT_TRACEBACK=1`` shows where it
    came from.

    Args:
        verb: Takes the settings and the overrides that led to them.
        name: What the program is called.
    """
    # Without this Hydra prints a screen of its own and ends the program itself.
    os.environ["HYDRA_FULL_ERROR"] = "1"

    ignore_torchrl_warnings()

    @hydra.main(config_path=str(configuration.config_dir().absolute()), config_name="config", version_base="1.3")
    def application(composed: DictConfig) -> None:
        overrides = list(HydraConfig.get().overrides.task)
        try:
            _check_program(name, overrides)
            verb(configuration.to_object(composed), overrides)
        except (ConfigError, FloatingPointError, OSError) as error:
            # Caught here because Hydra would print a line of its own first.
            fail(error)

    def fail(error: Exception) -> NoReturn:
        if os.environ.get("SKATEMOUNT_TRACEBACK"):
            raise error
        if isinstance(error, OSError) and error.filename is not None:
            text = f"{error.filename}: {error.strerror}"
        else:
            text = str(error) if isinstance(error, ConfigError) else configuration.one_line(error)
        print(f"skatemount.{name}: {text}", file=sys.stderr)
        sys.exit(2)

    try:
        sys.argv[1:] = _stage_first([_today(each) for each in sys.argv[1:]])
        _check_choices(sys.argv[1:])
        application()
    except KeyboardInterrupt:
        sys.exit(130)
    except Exception as error:
        if isinstance(error, ConfigError | OSError) or _from_hydra(error):
            fail(error)
        raise


def prepare_outputs(config: Config) -> None:
    """Make the folders that ``json`` and ``output`` name, now rather than after all the work.

    Args:
        config: As composed from the command line.

    Raises:
        ConfigError: A folder is where a file is to be.
    """
    if config.json is not None:
        if Path(config.json).is_dir():
            raise ConfigError(f"json={config.json} is a folder; it must name a file")
        Path(config.json).parent.mkdir(parents=True, exist_ok=True)
    if config.output is not None:
        Path(config.output).mkdir(parents=True, exist_ok=True)


def _check_program(name: str, overrides: list[str]) -> None:
    """Refuse a setting that this program would ignore."""
    for override in overrides:
        key = override.lstrip("+~").partition("=")[0]
        programs = _BELONGS_TO.get(key.partition(".")[0], (name,))
        if name not in programs:
            instead = f"; {_INSTEAD[name, key]}" if (name, key) in _INSTEAD else ""
            raise ConfigError(f"{override}: a setting of skatemount.{' and '.join(programs)} only{instead}")


def _today(argument: str) -> str:
    """Return an argument with the setting's name of today, and say so if the user wrote an older one."""
    renamed = argument if argument.startswith("-") else rename_override(argument)
    if renamed != argument:
        old, new = (each.lstrip("+~").partition("=")[0] for each in (argument, renamed))
        print(f"note: {old} is called {new} now", file=sys.stderr)
    return renamed


def _stage_first(arguments: list[str]) -> list[str]:
    """Put the stage before what is chosen on top of it, such as an experiment: the later one wins in Hydra.

    Only overrides change places, among themselves: options such as ``-m`` stay where they are.
    """
    settings = [a for a in arguments if "=" in a and not a.startswith("-")]
    ordered = iter(sorted(settings, key=lambda a: not a.startswith("+stage=")))
    return [next(ordered) if a in settings else a for a in arguments]


def _check_choices(arguments: list[str]) -> None:
    """Name the stages or suites there are, which Hydra's own message on an unknown one does not do in a line."""
    for argument in arguments:
        key, _, value = argument.partition("=")
        if key in ("stage", "+stage", "++stage"):
            if not key.startswith("+"):
                raise ConfigError(f"{argument}: write +stage={value}")
            for each in value.split(","):
                configuration.check_stage(each)
        if key == "suite":
            if "null" in value.split(","):
                raise ConfigError(f"{argument}: leave suite out for the checkpoint's own task")
            for each in value.split(","):
                configuration.check_suite(each)


def _from_hydra(error: BaseException) -> bool:
    return type(error).__module__.split(".")[0] in ("hydra", "omegaconf")
