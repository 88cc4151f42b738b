"""Settings of a command line that cannot matter beside the others, which is a mistake of whoever wrote them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

from skatemount.config.film import FAILED
from skatemount.config.overrides import Override, is_hydras
from skatemount.config.programs import (
    EvaluateConfig,
    ExportConfig,
    PlayConfig,
    PolicyConfig,
    RecordConfig,
    ReportConfig,
)
from skatemount.envs.config.task import TaskConfig
from skatemount.utils.errors import ConfigError

Rule = Callable[[str], str | None]
"""Takes the key of a setting that was given; returns why it cannot matter, or None."""


def check_used(config: TaskConfig, overrides: Sequence[str]) -> None:
    """Refuse settings that cannot matter beside the others.

    Args:
        config: Settings of a program.
        overrides: The settings that the user gave, under today's names.

    Raises:
        ConfigError: A setting has no effect.
    """
    rule = _rule(config)
    for written in overrides:
        override = Override.parse(written)
        if rule is not None and not is_hydras(written) and override.value is not None:
            if (reason := rule(override.key)) is not None:
                raise ConfigError(f"{written} {reason}")


def _rule(config: TaskConfig) -> Rule | None:
    if isinstance(config, ReportConfig):
        return lambda key: _report(config, key)
    if isinstance(config, PolicyConfig):
        return lambda key: _policy(config, key)
    return None


def _policy(config: PolicyConfig, key: str) -> str | None:
    if key == "switch_distance" and config.pipeline is None and not isinstance(config, ExportConfig):
        return "needs two policies, such as pipeline=gait+anywhere"
    if isinstance(config, RecordConfig):
        return _record(config, key)
    if isinstance(config, PlayConfig) and config.viewer == "native":
        return _PAGE if key in ("host", "port", "open_browser", "plain") else None
    if isinstance(config, ExportConfig):
        return _export(config, key)
    assert isinstance(config, EvaluateConfig | PlayConfig), config
    return None


_PAGE = "with viewer=native: only the page has it; leave out one of the two"


def _record(config: RecordConfig, key: str) -> str | None:
    if key == "failures" and config.episodes != FAILED:
        return f"needs episodes={FAILED}"
    named = "episode" if config.episode is not None else "episodes" if config.episodes not in (None, FAILED) else None
    if key == "searched" and named is not None:
        return f"with {named}=: nothing is looked for when the episodes are named; leave out one of the two"
    if key == "film.gif_width" and not config.film.gif:
        return "needs film.gif=true"
    return None


def _export(config: ExportConfig, key: str) -> str | None:
    top = key.partition(".")[0]
    # The observation of a policy that was trained on boards that vary is exported for one.
    of_starts = top in ("suite", "task") or top in _OF_TASK and top != "boards"
    if config.format == "torch" and (of_starts or key in ("episodes", "seed")):
        return "with format=torch: only format=onnx has start states; leave out one of the two"
    if config.episodes == 0 and of_starts:
        return "with episodes=0: it is for start states, and there are none; leave out one of the two"
    if key == "switch_distance":
        return "is for two policies, and an export is for one"
    return None


_OF_TASK = {each.name for each in dataclasses.fields(TaskConfig)} - {"physics", "plugins"}
"""Settings of the task that are not the machine's."""


def _report(config: ReportConfig, key: str) -> str | None:
    # The page would be about the newest run.
    if key == "runs" and not config.runs or key in ("run", "against", "sweep") and getattr(config, key) == "":
        return "names no run; give some, or leave it out"
    several = f"sweep={config.sweep}" if config.sweep is not None else "runs=" if config.runs else None
    evaluates = not config.paper and bool(config.page.suites if config.page.suites is not None else several is None)
    instead = "paper=true" if config.paper else several or "page.suites=[]"
    if key in ("page.film_width", "page.megabytes") and (config.paper or several is not None):
        return f"with {instead}: that page has no films"
    if key == "page.films" and config.page.films and not config.paper and (several is not None or not evaluates):
        return f"with {instead}: that page films no episodes"
    if key == "page.film_width" and not config.page.films:
        return "with page.films=0: nothing is filmed"
    hint = "" if config.paper else "; page.suites=[own] evaluates the task of the training"
    of_task = key.partition(".")[0] in _OF_TASK
    if (key == "page.episodes" or of_task) and not evaluates:
        return f"with {instead}: nothing is evaluated{hint}"
    return None
