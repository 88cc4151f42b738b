"""Draw the learning curve of a whole training: success and reward over steps and hours, in one color per stage.

    python tools/plot_training.py runs/skatemount/2026-..._paper out.png
    python tools/plot_training.py runs/skatemount/2026-..._balance runs/skatemount/2026-..._unfixed out.png

Several runs are drawn one after the other. A run of a chain of stages is drawn as its stages.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from skatemount.runs.folder import RunFolder
from skatemount.training.plots import plot_chain
from skatemount.utils.errors import ConfigError


def main() -> None:
    """Read the metrics of the runs and draw them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="+", type=Path, help="run folders, in the order of the training")
    parser.add_argument("picture", type=Path, help="PNG to write")
    parser.add_argument("--title", default="")
    options = parser.parse_args()
    try:
        runs = [part for path in options.runs for run in [RunFolder.open(path)] for part in run.parts or [run]]
        plot_chain([(_name(run), run.metrics_file) for run in runs], options.picture, options.title)
    except ConfigError as error:
        sys.exit(f"plot_training: {error}")
    print(options.picture)


def _name(run: RunFolder) -> str:
    """Return the stage of a run, with its curriculum if it has one."""
    config = run.config
    kind = config["curriculum"]["kind"]
    curriculum = {"none": "", "auto": ", automatic curriculum"}.get(kind, f", curriculum {kind}")
    return f"{config['stage']['name']}{curriculum}"


if __name__ == "__main__":
    main()
