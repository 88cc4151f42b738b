"""Commands that go on from a run, to be pasted into a shell."""

from __future__ import annotations

import shlex

from skatemount import config as configuration
from skatemount.config.files import load_file
from skatemount.config.plugins import written
from skatemount.runs import checkpoint
from skatemount.runs.folder import RunFolder


def next_commands(run: RunFolder) -> str:
    """Return the commands that evaluate and film a run's latest policy, one a line, to be pasted into a shell.

    The suite is the first one of the run's stage that is named after it; the training's own task if there is none.
    """
    stage = run.config["stage"]["name"] if run.latest is None else checkpoint.read_card(run.latest).stage
    plugins = run.config.get("plugins")
    policy = [f"checkpoint={run.path}", *([written(plugins)] if plugins else [])]
    # A stage of one's own may be called like a part of a suite's name.
    named = [name for name in configuration.suites() if stage in name.split("-")]
    suite = [f"suite={name}" for name in named if load_file("suite", name).get("stage") == stage][:1]
    options = configuration.config_dir_options() if suite else []
    evaluate = ["python", "-m", "skatemount.evaluate", *options, *policy, *suite]
    return f"next:\n  {shlex.join(evaluate)}\n  {shlex.join(['python', '-m', 'skatemount.record', *policy])}"


def what_is_left(run: RunFolder, frames: int) -> str:
    """Return where a run's last checkpoint is, and the command that goes on from it.

    Args:
        run: The run, whose training has ended.
        frames: Environment steps at its last checkpoint.
    """
    if run.latest is None:
        return f"nothing was trained in {run.path}"
    command = shlex.join(["python", "-m", "skatemount.train", f"resume={run.path}"])
    return f"{frames:,} steps are saved in {run.latest}; go on with: {command}"
