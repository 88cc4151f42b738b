"""The command line of every `python -m skatemount.<verb>`: Hydra composes the settings, errors are one line."""

from __future__ import annotations

import os
import sys
import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from skatemount import launchers, multirun
from skatemount.config import config_dir, set_user_config_dir, stages, suites, user_config_dir
from skatemount.config.compose import checked, composed_values, plain
from skatemount.config.messages import as_written, is_of_library, reason
from skatemount.config.overrides import check_option, is_hydras, prepare, read
from skatemount.config.own_files import check_own_files
from skatemount.config.unused import check_used
from skatemount.config.versions import renaming
from skatemount.utils.errors import ConfigError
from skatemount.utils.quiet import ignore_library_warnings
from skatemount.utils.terminal import safe_streams


@safe_streams()
def run(verb: Callable[..., float | None], program: str) -> None:
    """Compose the settings from the command line and run a verb on them; `-m` runs it once for each combination.

    A mistake in the settings ends the program with one line and status 2; ``SKATEMOUNT_TRACEBACK=1`` shows where it
    came from. A job of a multirun that fails does not keep the others from running; the status is 1 then.

    Args:
        verb: Takes the program's settings, a dataclass, and the overrides that led to them; `skatemount.train.train`
            takes its job of a multirun as well. Returns the success rate, if it measures one.
        program: Name of the program, and of its file in ``conf/``.
    """
    # Without this Hydra prints a screen of its own and ends the program itself.
    os.environ["HYDRA_FULL_ERROR"] = "1"
    ignore_library_warnings()
    given = sys.argv[1:]

    def fail(error: Exception) -> NoReturn:
        if os.environ.get("SKATEMOUNT_TRACEBACK"):
            raise error
        print(f"skatemount.{program}: {as_written(reason(error), given)}", file=sys.stderr)
        sys.exit(2)

    @hydra.main(config_path=str(config_dir().absolute()), config_name=program, version_base="1.3")
    def application(composed: DictConfig) -> None:
        try:
            # Paths in settings are relative to the folder where the command started, also with hydra.job.chdir.
            os.chdir(HydraConfig.get().runtime.cwd)
            config, overrides = checked(plain(composed), program), list(HydraConfig.get().overrides.task)
            check_used(config, overrides)
            verb(config, overrides)
        except (ConfigError, FloatingPointError, OSError) as error:
            # Caught here because Hydra would print a line of its own first.
            fail(error)

    try:
        set_user_config_dir(config_dir_of(sys.argv[1:]))
        if {"--help", "-h"} & set(sys.argv[1:]):
            print(help_text(program))
            return
        sys.argv[1:], settings = _prepared(_options_first(sys.argv[1:]), program)
        check_own_files(settings)
        launchers.check(settings, multirun.is_asked_for(sys.argv[1:]))
        if multirun.is_asked_for(sys.argv[1:]):
            if multirun.run(verb, program, settings):
                sys.exit(1)
            return
        if user_config_dir() is not None:
            # Hydra ends in a traceback about some mistakes in a file; composing alone is one line about any.
            composed_values(program, [each for each in settings if not is_hydras(each)])
        application()
    except Exception as error:
        if isinstance(error, ConfigError | OSError) or is_of_library(error):
            fail(error)
        raise


def config_dir_of(arguments: Sequence[str]) -> str | None:
    """Return the folder that ``--config-dir`` names among a command line's arguments; None without one.

    Raises:
        ConfigError: The option has no value.
    """
    for i, argument in enumerate(arguments):
        option, equals, value = argument.partition("=")
        if option not in ("--config-dir", "-cd"):
            continue
        if equals:
            return value
        if i + 1 == len(arguments):
            raise ConfigError(f"{argument}: give the folder, {argument} my_conf")
        return arguments[i + 1]
    return None


def help_text(program: str) -> str:
    """Return a program's help: its purpose, examples and settings, from its file in ``conf/``."""
    template = OmegaConf.load(config_dir() / f"{program}.yaml").hydra.help.template
    lines = []
    for line in template.rstrip().splitlines():
        for word, names in (("$STAGES", stages()), ("$SUITES", suites())):
            line = line.replace(word, ", ".join(names))
        lines += textwrap.wrap(line, 110, subsequent_indent=" " * 17, drop_whitespace=False) or [""]
    return "\n".join(line.rstrip() for line in lines)


def prepare_outputs(json: str | None, output: str | None) -> None:
    """Make the folders of results before the work that leads to them.

    Args:
        json: File for results.
        output: Folder for what is made.

    Raises:
        ConfigError: ``json`` is a folder.
    """
    if json is not None:
        if Path(json).is_dir():
            raise ConfigError(f"json={json} is a folder; it must name a file")
        Path(json).parent.mkdir(parents=True, exist_ok=True)
    if output is not None:
        Path(output).mkdir(parents=True, exist_ok=True)


def _options_first(arguments: Sequence[str]) -> list[str]:
    """Return a command line's arguments with its options, and their values, before the settings.

    Hydra's parser refuses settings on both sides of an option.
    """
    options: list[str] = []
    settings: list[str] = []
    for argument in arguments:
        is_value = bool(options) and options[-1] in _WITH_VALUE
        (options if is_value or argument.startswith("-") else settings).append(argument)
    return [*options, *settings]


def _prepared(arguments: list[str], program: str) -> tuple[list[str], list[str]]:
    """Return the command line's arguments with the overrides in Hydra's form, and these overrides alone."""
    result: list[str] = []
    settings: list[str] = []
    options_value = False
    several = multirun.is_asked_for(arguments)
    roots = [each for each in arguments if each.startswith("logger.root=")]
    for argument in arguments:
        if not argument.isprintable() and argument != argument.encode(errors="replace").decode():
            raise ConfigError(f"{argument}: not text in this locale; set LC_ALL to one with UTF-8, such as C.UTF-8")
        # Options such as --config-dir take the next argument.
        is_setting = not options_value and not argument.startswith("-")
        options_value = argument.startswith("-") and argument in _WITH_VALUE
        if not is_setting:
            if argument.startswith("-"):
                check_option(argument, program)
            result.append(argument)
            continue
        if (renamed := renaming(argument)) is not None:
            print(f"note: {renamed}", file=sys.stderr)
        # Paths may be relative to the folder of all runs.
        settings.append(prepare([*roots, argument], program, several)[-1])
        read(settings[-1])
        result.append(settings[-1])
    return result, settings


_WITH_VALUE = {"--config-path", "-cp", "--config-name", "-cn", "--config-dir", "-cd", "--cfg", "-c", "--package", "-p",
               "--info", "-i", "--experimental-rerun"}  # fmt: skip
