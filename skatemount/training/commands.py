"""Commands that go on from a run, to be pasted into a shell."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from skatemount import config as configuration
from skatemount.config.compose import composed_values
from skatemount.config.files import choices, load_file
from skatemount.config.plugins import modules_of, written
from skatemount.runs import checkpoint
from skatemount.runs.folder import RunFolder, is_run
from skatemount.runs.sweep import key_of
from skatemount.utils.errors import ConfigError, StorageError
from skatemount.utils.ranks import Ranks
from skatemount.utils.signals import Ended

if TYPE_CHECKING:
    from skatemount.training.trainer import Trainer


def next_commands(run: RunFolder) -> str:
    """Return the commands that evaluate and film a run's latest policy, one a line, to be pasted into a shell.

    The suite is the first one of the run's stage and task that is named after the stage; the training's own task if
    there is none.
    """
    values = run.config
    stage = values["stage"]["name"] if run.latest is None else checkpoint.read_card(run.latest).stage
    policy = policy_settings(run)
    # A stage of one's own may be called like a part of a suite's name.
    named = (name for name in choices("suite") if stage in name.split("-"))
    suite = next(([f"suite={name}"] for name in named if _is_of(name, stage, values.get("success"))), [])
    options = configuration.config_dir_options() if suite else []
    evaluate = ["python", "-m", "skatemount.evaluate", *options, *policy, *suite]
    return f"next:\n  {shlex.join(evaluate)}\n  {shlex.join(['python', '-m', 'skatemount.record', *policy])}"


def policy_settings(run: RunFolder) -> list[str]:
    """Return the settings that name a run's latest policy on a command line, with the modules that it needs."""
    modules = modules_of(run.config, training=False)
    return [f"checkpoint={run.path}", *([written(modules)] if modules else [])]


def what_is_left(trainer: Trainer) -> str:
    """Return where the last checkpoint of a training is, and the command that goes on from it.

    Args:
        trainer: The training, which has ended.
    """
    run, frames, ranks = trainer.run, trainer.saved_frames, trainer.ranks
    if not ranks.first:
        # It is on another machine, or rank 0 has said it.
        return f"rank 0 has the run {run.path}; {_resume(f'resume={run.path}', ranks)}"
    if not frames:
        return f"nothing was trained in {run.path}" if run.path.exists() else "nothing was trained"
    if not is_run(run.path):
        return f"the run {run.path} is gone; if it was moved, {_resume('resume=<its folder>', ranks)}"
    # A complete training has nothing to resume but its evaluation; of a chain, the next stage.
    complete = trainer.stopping and frames == trainer.frames and run.parent is None
    modules = modules_of(run.config)
    settings = [f"resume={run.path}", *_changed(trainer.overrides), *([written(modules)] if modules else [])]
    way = _resume(shlex.join(settings), ranks)
    if complete:
        way = f"go on with: {shlex.join(['python', '-m', 'skatemount.evaluate', *policy_settings(run)])}"
    return f"{frames:,} steps are saved in {run.latest}; {way}"


def _resume(settings: str, ranks: Ranks) -> str:
    """Return how to start a training again, with one command or with one on each machine."""
    if ranks.command is None:
        return f"start the same torchrun commands on every machine, with {settings} instead of the other settings"
    return f"go on with: {shlex.join([*ranks.command, '-m', 'skatemount.train'])} {settings}"


def _changed(overrides: Sequence[str]) -> list[str]:
    """Return the settings of a command that resumed a run and changed them, which the run has not saved."""
    if not any(key_of(each) == "resume" for each in overrides):
        return []
    return [each for each in overrides if key_of(each) not in ("resume", "plugins", "logger.root")]


@contextmanager
def naming_what_is_left(trainer: Trainer) -> Iterator[None]:
    """Let requests to end and errors of files name the last checkpoint and the way on, for a ``with`` block.

    Args:
        trainer: The training.

    Raises:
        Ended: A signal ended the block.
        StorageError: A file could not be written, such as on a full disk.
    """
    try:
        yield
    except Ended as end:
        raise Ended(end.signum, what_is_left(trainer)) from None
    except StorageError:
        raise
    except OSError as error:
        raise StorageError(error, what_is_left(trainer)) from error


def _is_of(suite: str, stage: str, success: str | None) -> bool:
    """Return whether a suite tests a stage, with the run's own task.

    Args:
        suite: Name of the suite.
        stage: Name of the run's stage.
        success: The task of the run; None if its saved settings do not say.
    """
    try:
        values = load_file("suite", suite)
        if values.get("stage") != stage:
            return False
        changes = [*values.get("overrides", []), *next(iter(values.get("variants", {}).values()), [])]
        return success in (None, composed_values("train", [f"stage={stage}", *changes])["success"])
    except ConfigError:
        # A file of one's own that is broken, or the stage of another folder.
        return False
