"""`python -m skatemount.bench stage=<name>`: how fast training is on this machine, and what limits it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from skatemount.utils.signals import exiting_by_signals

if TYPE_CHECKING:
    from skatemount.config import BenchProgramConfig

NOT_TRAINING = ("bench", "json", "output")
"""Settings of this program alone."""


def bench(config: BenchProgramConfig, overrides: list[str]) -> None:
    """Measure a training and its parts side by side, print tables and draw a picture.

    Raw physics is the engine stepping the same states with the same actions and nothing else; the other figures are
    given as fractions of it. Settings: ``bench.*``, ``json`` (file for the figures), ``output`` (folder for the
    picture). Everything else is the training's.

    Args:
        config: As composed from the command line.
        overrides: What the user asked for.

    Raises:
        ConfigError: A setting that cannot be used.
    """
    from skatemount.cli import prepare_outputs
    from skatemount.profiling import report
    from skatemount.profiling.measure import measure
    from skatemount.runs import atomic

    prepare_outputs(config.json, config.output)
    training = [o for o in overrides if o.lstrip("+~").split("=")[0].split(".")[0] not in NOT_TRAINING]
    measured = measure(config, training, lambda doing: print(f"measuring {doing}", flush=True))
    written = []
    if config.json is not None:
        written.append(Path(config.json))
        atomic.write_text(written[-1], json.dumps(measured.to_dict(), indent=2) + "\n")
    if config.output is not None:
        written.append(Path(config.output) / "bench.png")
        report.draw(measured, written[-1])
    print("", report.text(measured), sep="\n")
    for path in written:
        print(f"written to {path}")


def main() -> None:
    """Run the program."""
    with exiting_by_signals("bench"):
        from skatemount.rendering import opengl

        opengl.disable()
        # Only now: composing the settings may import dm_control, which would look for a display.
        from skatemount import cli

        cli.run(bench, "bench")


if __name__ == "__main__":
    main()
