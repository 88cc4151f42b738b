"""Train with the ranks of a test: `torchrun rank_program.py SETTINGS.json`.

The file has one list of settings for each training. All ranks run the program. A training whose settings have
``resume`` continues the run of the list before.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from skatemount.config import compose
from skatemount.training.distributed import JoinedRanks, joined
from skatemount.training.follower import follow
from skatemount.training.resume import resume_config
from skatemount.training.trainer import Trainer


def main() -> None:
    """Train one after the other, and write the runs' folders beside the settings."""
    path = Path(sys.argv[1])
    runs: list[str] = []
    trainings = json.loads(path.read_text())
    with joined(compose(None, trainings[0])) as ranks:
        if isinstance(ranks, JoinedRanks) and not ranks.first:
            follow(ranks, compose(None, trainings[0]))
            return
        for given in trainings:
            given = [each.replace("LAST", runs[-1] if runs else "") for each in given]
            trainer = Trainer(resume_config(compose(None, given), given), given)
            try:
                trainer.train()
            finally:
                trainer.close()
            runs.append(str(trainer.run.path))
    path.with_suffix(".runs").write_text(json.dumps(runs))


if __name__ == "__main__":
    main()
