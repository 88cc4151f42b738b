"""`python -m skatemount.search stage=<name>`: search good settings of a training."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from skatemount.utils.signals import exiting_by_signals

if TYPE_CHECKING:
    from skatemount.config import SearchProgramConfig


def search(config: SearchProgramConfig, overrides: list[str]) -> None:
    """Search good settings, print the table of the trials and write the best settings as YAML.

    Settings: ``search.*`` (what is searched, see `skatemount.config.search.SearchConfig`); everything else is the
    training's. The program exits with status 1 if no trial has succeeded.

    Args:
        config: As composed from the command line.
        overrides: What the user asked for.

    Raises:
        ConfigError: A setting that cannot be used.
    """
    from skatemount.searching import worker
    from skatemount.train import train

    if status := worker.search(config, overrides, train):
        sys.exit(status)


def main() -> None:
    """Run the program."""
    with exiting_by_signals("search"):
        from skatemount.rendering import opengl

        opengl.disable()
        # Only now: composing the settings may import dm_control, which would look for a display.
        from skatemount import cli

        cli.run(search, "search")


if __name__ == "__main__":
    main()
