"""`skatemount replay-diverged FILE`: do the control step again in which a world's physics failed."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from skatemount.envs.physics.replay import read, replay
from skatemount.utils.errors import ConfigError


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the first quantity that is not finite.

    The status is 1 if there is none, and 2 for files that do not fit.
    """
    parser = argparse.ArgumentParser(
        prog="skatemount replay-diverged",
        description="Do the control step again in which a world's physics failed, and print the first quantity that is "
        "not finite.",
        epilog="A training writes such files with logger.dump_diverged=<number of files>.",
    )
    parser.add_argument("file", type=Path, help="a file of the run's folder diverged; model.xml lies beside it")
    options = parser.parse_args(sys.argv[1:] if arguments is None else arguments)
    try:
        model, arrays = read(options.file)
        found = replay(model, arrays)
    except (ConfigError, OSError) as error:
        print(f"skatemount.replay-diverged: {error}", file=sys.stderr)
        sys.exit(2)
    print(f"world {int(arrays['world'])}, control step {int(arrays['episode_step']) + 1} of its episode")
    randomized = [name.removeprefix("model.") for name in arrays if name.startswith("model.")]
    print(f"randomized: {', '.join(randomized) or 'nothing'}")
    if found.finding is None:
        # A training on a GPU computes in single precision.
        print("it does not diverge here")
        sys.exit(1)
    print(found.finding)


if __name__ == "__main__":
    main()
